"""What a report is made from: the summary of a run, and those of its bags that are drawn."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from tel_ros.core.config import Config
from tel_ros.core.errors import BagError, InputFileError
from tel_ros.core.trial import LoopTiming, Outcome
from tel_ros.core.types import FloatArray
from tel_ros.recording.bag_writer import UNFINISHED
from tel_ros.recording.config_file import load_config
from tel_ros.recording.run_folder import CONFIG_FILE, SUMMARY_FILE, read_summary
from tel_ros.recording.trial_bag import RecordedTrial, check_bag, read_trial
from tel_ros.recording.trial_timing import TIMING_FIELDS

Item = TypeVar("Item")


@dataclass(frozen=True)
class TrialSummary:
    """One row of ``summary.json``, keys as there; NaN where the row has no number."""

    index: int
    alpha: float
    duration_s: float
    rms_error_rad: float
    rms_error_per_joint_rad: tuple[float, ...]
    max_error_rad: float
    max_effort_nm: tuple[float, ...]
    saturated_ratio: float
    rms_command_change_rad: float
    training_rms_before_rad: float
    training_rms_after_rad: float
    grown: tuple[str, ...]
    outcome: str
    message: str
    bag: str | None
    wall_s: float
    reason: str = ""
    warning: str = ""
    went_back_to: int | None = None
    expected_rms_rad: float = math.nan
    timing: LoopTiming | None = None

    @classmethod
    def of(cls, row: Mapping[str, Any]) -> TrialSummary:
        """Read a row.

        Raises:
            KeyError, TypeError, ValueError: a key is missing or has a value of the wrong kind.
        """
        return cls(
            index=int(row["index"]),
            alpha=_number(row["alpha"]),
            duration_s=_number(row["duration_s"]),
            rms_error_rad=_number(row["rms_error_rad"]),
            rms_error_per_joint_rad=_numbers(row["rms_error_per_joint_rad"]),
            max_error_rad=_number(row["max_error_rad"]),
            max_effort_nm=_numbers(row["max_effort_nm"]),
            saturated_ratio=_number(row["saturated_ratio"]),
            rms_command_change_rad=_number(row["rms_command_change_rad"]),
            training_rms_before_rad=_number(row["training_rms_before_rad"]),
            training_rms_after_rad=_number(row["training_rms_after_rad"]),
            grown=tuple(str(item) for item in row["grown"]),
            outcome=str(row["outcome"]),
            message=str(row["message"]),
            bag=None if row["bag"] is None else str(row["bag"]),
            wall_s=_number(row["wall_s"]),
            # Runs of earlier versions do not have these.
            reason=str(row.get("reason") or ""),
            warning=str(row.get("warning") or ""),
            went_back_to=row.get("went_back_to"),
            expected_rms_rad=_number(row.get("expected_rms_rad")),
            timing=_timing(row.get("timing")),
        )

    @property
    def completed(self) -> bool:
        """Whether the trial ran to its end."""
        return self.outcome == Outcome.COMPLETED.name.lower()

    @property
    def was_learned_from(self) -> bool:
        """Whether the network was trained on it."""
        return math.isfinite(self.training_rms_after_rad)

    @property
    def reached_run(self) -> bool:
        """Whether there was any movement to speak of: the error is known from RUN alone."""
        return math.isfinite(self.rms_error_rad)


@dataclass(frozen=True)
class DrawnTrial:
    """A trial whose curves are shown."""

    summary: TrialSummary
    recorded: RecordedTrial

    @property
    def error_rad(self) -> FloatArray:
        """Measured minus desired position in RUN. Shape (n_run, n_joints)."""
        trial = self.recorded
        error: FloatArray = (trial.position_rad - trial.desired[:, : len(trial.joints)])[trial.run]
        return error

    @property
    def is_std_known(self) -> bool:
        """Whether the network expected anything of its command at any time."""
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
    """Everything that a report says.

    Args:
        folder: of the run.
        config: as written in the folder.
        outcome: of the run.
        message: why it did not complete.
        trials: all of them, in order; at least one.
        drawn: the first, the middle and the last of those that can be drawn; each once.
        drawable: all that can be drawn, as far as is known without reading them.
        notes: what is missing from the report, and why.
    """

    folder: Path
    config: Config
    outcome: str
    message: str
    trials: tuple[TrialSummary, ...]
    drawn: tuple[DrawnTrial, ...]
    drawable: tuple[TrialSummary, ...]
    notes: tuple[str, ...]

    @property
    def decides(self) -> bool:
        """Whether the strategy gave reasons for its trials."""
        return any(trial.reason for trial in self.trials)

    @property
    def is_timed(self) -> bool:
        """Whether the loop was measured in any trial: not in lockstep."""
        return any(trial.timing is not None for trial in self.trials)

    @property
    def varies_speed_alone(self) -> bool:
        """Whether all trials are the same movement but for its speed."""
        practice = self.config.practice
        return practice.strategy != "subtasks" and tuple(practice.vary) == ("speed",)


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
    return RunData(
        folder=folder,
        config=config,
        outcome=str(summary.get("outcome", "unknown")),
        message=str(summary.get("message") or ""),
        trials=trials,
        drawn=drawn,
        drawable=drawable,
        notes=(*notes, *_unfinished(folder)),
    )


def spread(items: Sequence[Item]) -> list[Item]:
    """Return the first, the middle and the last, each once."""
    places = sorted({0, len(items) // 2, len(items) - 1}) if items else []
    return [items[place] for place in places]


def read_drawable(run: RunData, most: int) -> list[DrawnTrial]:
    """Return the trials that can be drawn, evenly chosen where there are more than so many.

    A bag that turns out not to be readable is left out: whatever is drawn of the run says so.
    """
    places = np.unique(
        np.linspace(0, len(run.drawable) - 1, min(most, len(run.drawable))).round().astype(int)
    )
    read = {trial.summary.index: trial for trial in run.drawn}
    found = []
    for summary in (run.drawable[place] for place in places):
        try:
            found.append(
                read.get(summary.index)
                or DrawnTrial(summary, _read(run.folder / str(summary.bag), run.config.arm.joints))
            )
        except BagError:
            continue
    return found


def _trials(file: Path, summary: Mapping[str, Any]) -> tuple[TrialSummary, ...]:
    expected = "the summary of a practice run"
    try:
        trials = tuple(TrialSummary.of(row) for row in summary["trials"])
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputFileError(file, f"not readable ({type(error).__name__}: {error})", expected) from error
    if not trials:
        why = f": {summary['message']}" if summary.get("message") else ""
        raise InputFileError(file, f"holds no trial{why}", "a run with at least one trial to report on")
    return trials


def _drawn(
    folder: Path, trials: Sequence[TrialSummary], joints: tuple[str, ...]
) -> tuple[tuple[DrawnTrial, ...], tuple[TrialSummary, ...], list[str]]:
    """Read the bags of the trials to draw, taking others in place of those that cannot be read."""
    problems = {trial.index: _problem(trial) for trial in trials if _problem(trial)}
    read: dict[int, RecordedTrial] = {}
    while True:
        chosen = spread([trial for trial in trials if trial.index not in problems])
        unread = [trial for trial in chosen if trial.index not in read]
        if not unread:
            break
        for trial in unread:
            try:
                read[trial.index] = _read(folder / str(trial.bag), joints)
            except BagError as error:
                problems[trial.index] = _complaint(folder, error)
    drawn = tuple(DrawnTrial(trial, read[trial.index]) for trial in chosen)
    for trial in trials:
        if trial.bag is not None and trial.index not in (problems.keys() | read.keys()):
            try:
                check_bag(folder / trial.bag)
            except BagError as error:
                problems[trial.index] = _complaint(folder, error)
    drawable = tuple(trial for trial in trials if trial.index not in problems)
    notes = [f"Trial {index} is not drawn: {problem}." for index, problem in sorted(problems.items())]
    return drawn, drawable, notes


def _problem(trial: TrialSummary) -> str:
    """Return why a trial cannot be drawn, as far as its row tells."""
    if trial.bag is None:
        return "it has no bag"
    return "" if trial.reached_run else f"it was {trial.outcome} before the movement began"


def _read(bag: Path, joints: tuple[str, ...]) -> RecordedTrial:
    trial = read_trial(bag)
    if trial.joints != joints:
        raise BagError(bag, f"has the joints {', '.join(trial.joints)}", f"{', '.join(joints)}")
    if not trial.run.any():
        raise BagError(bag, "holds no control state of the movement", "some")
    return trial


def _complaint(folder: Path, error: BagError) -> str:
    # Names as seen from the run's folder: a report is read on other machines, too.
    return f"its bag cannot be used: {error}".replace(f"{folder}/", "")


def _unfinished(folder: Path) -> list[str]:
    bags = sorted(bag.name for bag in (folder / UNFINISHED).glob("*") if bag.is_dir())
    return [f"The recording {bag} was never finished; what there is lies in {UNFINISHED}." for bag in bags]


def _timing(values: Mapping[str, Any] | None) -> LoopTiming | None:
    if values is None:
        return None
    numbers = {name: _number(values[name]) for name in TIMING_FIELDS}
    return LoopTiming(**numbers, missed_ticks=int(values["missed_ticks"]), warning=str(values["warning"]))


def _number(value: Any) -> float:
    return math.nan if value is None else float(value)


def _numbers(values: Sequence[Any]) -> tuple[float, ...]:
    return tuple(_number(value) for value in values)
