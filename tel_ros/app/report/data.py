"""What a report is made from: the summary of a run, and the bags of the trials that are drawn."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from tel_ros.core.config import Config
from tel_ros.core.errors import BagError, InputFileError
from tel_ros.core.kinematics import SerialChain
from tel_ros.core.types import FloatArray, evenly_spaced
from tel_ros.recording.bag_writer import UNFINISHED
from tel_ros.recording.config_file import load_config
from tel_ros.recording.run_folder import CONFIG_FILE, SUMMARY_FILE, read_summary
from tel_ros.recording.summary import TrialRow
from tel_ros.recording.trial_bag import RecordedTrial, check_bag, read_trial
from tel_ros.recording.urdf import chain_to_hand, read_urdf

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
        if not known.any():
            return math.nan
        return float(np.mean(np.abs(self.error_rad[known]) <= 2.0 * std_rad[known]))


@dataclass(frozen=True)
class RunData:
    """Everything that a report shows of a run.

    Args:
        folder: of the run.
        config: as written in the folder.
        outcome: of the run.
        message: why it did not complete.
        trials: all of them, in order; at least one.
        drawn: the first, the middle and the last of those that can be drawn, each once.
        drawable: all that can be drawn, as far as is known without reading them.
        notes: what is missing from the report, and why.
    """

    folder: Path
    config: Config
    outcome: str
    message: str
    trials: tuple[TrialRow, ...]
    drawn: tuple[DrawnTrial, ...]
    drawable: tuple[TrialRow, ...]
    notes: tuple[str, ...]

    @property
    def varies_speed_alone(self) -> bool:
        """Whether all trials are the same movement at different speeds."""
        practice = self.config.practice
        return practice.strategy != "subtasks" and tuple(practice.vary) == ("speed",)

    @property
    def chain(self) -> SerialChain:
        """From the base to the hand."""
        arm = self.config.arm
        return chain_to_hand(read_urdf(Path(arm.urdf)), arm.joints, arm.hand_link)


def read_run(folder: Path) -> RunData:
    """Read a run folder. Bags that cannot be read are noted, not fatal.

    Raises:
        InputFileError: there is no summary, no configuration or no trial.
        ConfigError: the configuration is wrong.
    """
    summary = read_summary(folder)
    trials = _trials(folder / SUMMARY_FILE, summary)
    config = load_config(folder / CONFIG_FILE)
    drawn, drawable, notes = _drawn(folder, trials, config.arm.joints)
    unfinished = sorted(bag.name for bag in (folder / UNFINISHED).glob("*") if bag.is_dir())
    notes += [
        f"The recording {bag} was never finished; what there is lies in {UNFINISHED}." for bag in unfinished
    ]
    outcome, message = str(summary.get("outcome", "unknown")), str(summary.get("message") or "")
    return RunData(folder, config, outcome, message, trials, drawn, drawable, tuple(notes))


def spread(items: Sequence[Item]) -> list[Item]:
    """Return the first, the middle and the last, each once."""
    places = sorted({0, len(items) // 2, len(items) - 1}) if items else []
    return [items[place] for place in places]


def read_drawable(run: RunData, most: int) -> list[DrawnTrial]:
    """Return the trials that can be drawn, evenly chosen if there are more than ``most``.

    A bag that turns out to be unreadable is left out.
    """
    read = {trial.summary.index: trial for trial in run.drawn}
    found = []
    for place in evenly_spaced(len(run.drawable), most):
        summary = run.drawable[place]
        try:
            found.append(
                read.get(summary.index)
                or DrawnTrial(summary, _read(run.folder / summary.bag, run.config.arm.joints))
            )
        except BagError:
            continue
    return found


def _trials(file: Path, summary: Mapping[str, Any]) -> tuple[TrialRow, ...]:
    expected = "the summary of a practice run"
    try:
        trials = tuple(TrialRow.from_plain(row) for row in summary["trials"])
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputFileError(file, f"not readable ({type(error).__name__}: {error})", expected) from error
    if not trials:
        why = f": {summary['message']}" if summary.get("message") else ""
        raise InputFileError(file, f"holds no trial{why}", "a run with at least one trial to report on")
    return trials


def _drawn(
    folder: Path, trials: Sequence[TrialRow], joints: tuple[str, ...]
) -> tuple[tuple[DrawnTrial, ...], tuple[TrialRow, ...], list[str]]:
    """Read the bags of the trials to draw, taking others in place of those that cannot be read."""
    problems = {trial.index: why for trial in trials if (why := _problem(trial))}
    read: dict[int, RecordedTrial] = {}
    while True:
        chosen = spread([trial for trial in trials if trial.index not in problems])
        unread = [trial for trial in chosen if trial.index not in read]
        if not unread:
            break
        for trial in unread:
            try:
                read[trial.index] = _read(folder / trial.bag, joints)
            except BagError as error:
                problems[trial.index] = _complaint(folder, error)
    for trial in trials:
        if trial.bag and trial.index not in (problems.keys() | read.keys()):
            try:
                check_bag(folder / trial.bag)
            except BagError as error:
                problems[trial.index] = _complaint(folder, error)
    return (
        tuple(DrawnTrial(trial, read[trial.index]) for trial in chosen),
        tuple(trial for trial in trials if trial.index not in problems),
        [f"Trial {index} is not drawn: {problem}." for index, problem in sorted(problems.items())],
    )


def _problem(trial: TrialRow) -> str:
    """Return why a trial cannot be drawn, as far as its row tells; empty: it can."""
    if not trial.bag:
        return "it has no bag"
    return "" if trial.reached_run else f"it was {trial.outcome.text} before the movement began"


def _read(bag: Path, joints: tuple[str, ...]) -> RecordedTrial:
    trial = read_trial(bag)
    if trial.joints != joints:
        raise BagError(bag, f"has the joints {', '.join(trial.joints)}", f"{', '.join(joints)}")
    if not trial.run.any():
        raise BagError(bag, "holds no control state of the movement", "some")
    return trial


def _complaint(folder: Path, error: BagError) -> str:
    # Names relative to the run: a report is read on other machines, too.
    return f"its bag cannot be used: {error}".replace(f"{folder}/", "")
