"""What a report is made from: the summary of a run, and the bags of the trials that are drawn."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import numpy as np

from tel_ros.core.config import Config
from tel_ros.core.errors import BagError, InputFileError
from tel_ros.core.kinematics import SerialChain
from tel_ros.core.types import FloatArray, evenly_spaced
from tel_ros.recording.bag_writer import UNFINISHED
from tel_ros.recording.config_file import load_config
from tel_ros.recording.run_folder import CONFIG_FILE, SUMMARY_FILE
from tel_ros.recording.summary import TrialRow, read_rows
from tel_ros.recording.trial_bag import RecordedTrial, check_bag, read_trial
from tel_ros.recording.urdf import described

Item = TypeVar("Item")


@dataclass(frozen=True)
class DrawnTrial:
    """A trial whose curves are shown."""

    summary: TrialRow
    recorded: RecordedTrial

    @property
    def error_rad(self) -> FloatArray:
        """Measured minus desired position in RUN. Shape (n_run, n_joints)."""
        trial = self.recorded
        error: FloatArray = (trial.position_rad - trial.desired[:, : len(trial.joints)])[trial.run]
        return error

    @property
    def is_std_known(self) -> bool:
        """Whether the network gave a finite standard deviation of its command anywhere."""
        return bool(np.isfinite(self.recorded.command_std_rad).any())

    @property
    def share_within_two_std(self) -> float:
        """Share of the errors, over all joints, within the band where there is one; NaN without a band."""
        std_rad = self.recorded.command_std_rad
        known = np.isfinite(std_rad)
        within = np.abs(self.error_rad[known]) <= 2.0 * std_rad[known]
        return float(np.mean(within)) if known.any() else math.nan


@dataclass(frozen=True)
class RunData:
    """Everything that a report shows of a run, with its configuration as written in the folder."""

    folder: Path
    config: Config
    outcome: str
    message: str
    """Why it did not complete."""
    trials: tuple[TrialRow, ...]
    """All of them, in order; at least one."""
    drawn: tuple[DrawnTrial, ...]
    """The first, the middle and the last of those that can be drawn, each once; so many of each path."""
    drawable: tuple[TrialRow, ...]
    """All that can be drawn, as far as is known without reading them."""
    notes: tuple[str, ...]
    """What is missing from the report, and why."""

    def of_path(self, name: str) -> RunData:
        """Return the trials of one of several paths alone."""
        return replace(
            self,
            trials=tuple(row for row in self.trials if row.path == name),
            drawn=tuple(trial for trial in self.drawn if trial.summary.path == name),
            drawable=tuple(row for row in self.drawable if row.path == name),
        )

    @property
    def varies_speed_alone(self) -> bool:
        """Whether all trials are the same movement at different speeds."""
        practice = self.config.practice
        return practice.strategy != "subtasks" and tuple(practice.vary) == ("speed",)

    @property
    def why_not_drawn(self) -> str:
        """Why no movement can be drawn; empty: some can."""
        return "" if self.drawn else "Nothing to draw: there is no trial with a movement and a readable bag."

    @property
    def urdf(self) -> bytes:
        """The file that describes the arm."""
        return Path(self.config.arm.urdf).read_bytes()

    @property
    def chain(self) -> SerialChain:
        """From the base to the hand."""
        return described(self.config.arm).chain(self.config.arm.hand_link)

    def require_bags(self, page: Path) -> None:
        """Raise a BagError if trials had a movement and not one of their bags can be used, with all said."""
        if not self.drawn and any(not _problem(trial) for trial in self.trials):
            found = f"none of its bags can be used ({'; '.join(self.notes)})"
            raise BagError(self.folder, found, f"bags of trials; {page} shows the summary alone")


def read_run(folder: Path) -> RunData:
    """Read a run folder; bags that cannot be read are noted, not fatal.

    InputFileError: there is no summary, no configuration or no trial. ConfigError: the configuration is
    wrong.
    """
    trials, outcome, message = read_rows(folder)
    if not trials:
        why = f": {message}" if message else ""
        raise InputFileError(
            folder / SUMMARY_FILE, f"holds no trial{why}", "a run with at least one trial to report on"
        )
    config = load_config(folder / CONFIG_FILE)
    drawn, drawable, notes = _drawn(folder, trials, config.arm.joints)
    notes += [
        f"The recording {bag.name} was never finished; what there is lies in {UNFINISHED}."
        for bag in sorted((folder / UNFINISHED).glob("*"))
        if bag.is_dir()
    ]
    return RunData(folder, config, outcome, message, trials, drawn, drawable, tuple(notes))


def spread(items: Sequence[Item]) -> list[Item]:
    """Return the first, the middle and the last, each once."""
    return [items[place] for place in sorted({0, len(items) // 2, len(items) - 1})] if items else []


def read_drawable(run: RunData, most: int) -> list[DrawnTrial]:
    """Return the trials that can be drawn, evenly chosen if there are more than ``most``."""
    read = {trial.summary.index: trial for trial in run.drawn}
    found = []
    for row in (run.drawable[place] for place in evenly_spaced(len(run.drawable), most)):
        try:
            found.append(read.get(row.index) or _read(run.folder, row, run.config.arm.joints))
        except BagError:
            continue
    return found


def _drawn(
    folder: Path, trials: Sequence[TrialRow], joints: tuple[str, ...]
) -> tuple[tuple[DrawnTrial, ...], tuple[TrialRow, ...], list[str]]:
    """Read the bags of the trials to draw, taking others in place of those that cannot be read."""
    problems = {trial.index: why for trial in trials if (why := _problem(trial))}
    read: dict[int, DrawnTrial] = {}

    @contextmanager
    def noted(trial: TrialRow) -> Iterator[None]:
        try:
            yield
        except BagError as error:
            # Names relative to the run: a report is read on other machines, too.
            problems[trial.index] = f"its bag cannot be used: {error}".replace(f"{folder}/", "")

    while True:
        good = [trial for trial in trials if trial.index not in problems]
        paths = dict.fromkeys(trial.path for trial in good)
        chosen = [each for path in paths for each in spread([trial for trial in good if trial.path == path])]
        if not (unread := [trial for trial in chosen if trial.index not in read]):
            break
        for trial in unread:
            with noted(trial):
                read[trial.index] = _read(folder, trial, joints)
    for trial in trials:
        if trial.index not in (problems.keys() | read.keys()):
            with noted(trial):
                check_bag(folder / trial.bag)
    return (
        tuple(read[trial.index] for trial in chosen),
        tuple(trial for trial in trials if trial.index not in problems),
        [f"Trial {index} is not drawn: {problem}." for index, problem in sorted(problems.items())],
    )


def _problem(trial: TrialRow) -> str:
    """Return why a trial cannot be drawn, as far as its row tells; empty: it can."""
    if not trial.bag:
        return "it has no bag"
    return "" if trial.reached_run else f"it was {trial.outcome.text} before the movement began"


def _read(folder: Path, row: TrialRow, joints: tuple[str, ...]) -> DrawnTrial:
    bag = folder / row.bag
    trial = read_trial(bag)
    if trial.joints != joints:
        raise BagError(bag, f"has the joints {', '.join(trial.joints)}", f"{', '.join(joints)}")
    if not trial.run.any():
        raise BagError(bag, "holds no control state of the movement", "some")
    return DrawnTrial(row, trial)
