"""Going on with an interrupted run: what it had done, and its folder brought in order."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from tel_ros.core.config import Config
from tel_ros.core.errors import BagError, InputFileError, TrainingError, counted
from tel_ros.core.learning.learner import Learner, TrainingOutcome
from tel_ros.core.practice.session import PracticeSession, PractisedTrial, Prediction, predicted, trained
from tel_ros.core.practice.strategies import make_strategy
from tel_ros.core.practice.strategy import Ending, PlannedTrial
from tel_ros.core.trajectories.trajectory import DesiredTrajectory
from tel_ros.core.trial import Outcome, TrialReport
from tel_ros.recording.bag_writer import UNFINISHED
from tel_ros.recording.config_file import load_config
from tel_ros.recording.network_file import load_network, save_network
from tel_ros.recording.run_folder import (
    CONFIG_FILE,
    LOG_FOLDER,
    SUMMARY_FILE,
    json_ready,
    network_after,
    publish_network,
    read_summary,
    require_all_before_last,
    trial_bags,
    written_config,
)
from tel_ros.recording.shared_files import missing
from tel_ros.recording.summary import RunSummary, TrialRow
from tel_ros.recording.trial_bag import read_report, read_trial
from tel_ros.recording.waypoint_file import load_known_path, load_path

SET_ASIDE = "set_aside"
"""Folder in a run's folder: what an interrupted run has left and a resumed one does not go on from."""

_ENDED = ("completed", "stopped", "aborted")
_LEARNED = tuple(field.name for field in fields(TrainingOutcome))
_NOT_RECORDED = (*_LEARNED, "warning", "wall_s")
"""Columns of a row that neither the plan nor the bag tells."""
_AS_BEGUN = "the bags, the configuration and the version that the run was begun with"


class RecordedNetwork:
    """The networks that a run has saved, as the network of a practice session.

    A trial that was recorded but not learned from to the end is learned from again, and the network saved.
    """

    def __init__(self, folder: Path, config: Config) -> None:
        self._folder, self._config = folder, config
        self._learner: Learner | None = None  # None: has to be loaded
        self.after = 0
        """The trial whose network is asked."""
        self.row: TrialRow | None = None
        """What the summary tells of the trial to learn from; None: nothing."""

    def predict(self, desired: DesiredTrajectory) -> Prediction:
        """Return the command for a trajectory."""
        return predicted(self._now(), desired, self._config.control.rate_hz)

    def train(self, bag: Path) -> TrainingOutcome:
        """Return what was learned from a trial, and learn it again where its network is missing."""
        row = self.row
        if row is not None and not row.was_learned_from:
            raise TrainingError(f"nothing was learned from trial {row.index}")
        if row is not None and network_after(self._folder, row.index).is_file():
            self._learner = None
            return TrainingOutcome(**{name: getattr(row, name) for name in _LEARNED})
        self._learner, training = trained(self._now(), read_trial(bag), self._config)
        return training

    def save(self, index: int) -> None:
        """Go on with the network after a trial; it is written unless it is there."""
        file = network_after(self._folder, index)
        if not file.is_file():
            save_network(self._now(), file)
        self.after = index

    def load(self, index: int) -> None:
        """Go back to the network as it was after a trial."""
        self.after, self._learner = index, None

    def _now(self) -> Learner:
        if self._learner is None:
            self._learner = load_network(network_after(self._folder, self.after))
        return self._learner


@dataclass(frozen=True)
class EarlierTrials:
    """What a run had done before it was interrupted, with the rows of its summary."""

    session: PracticeSession[Path]
    """Has gone through all trials; asks the saved networks, and has no arm."""
    rows: tuple[TrialRow, ...]
    network_after: int
    """The trial whose network was the last one; 0: as the run began."""


def earlier_trials(folder: Path, config: Config, bags: Sequence[Path] | None = None) -> EarlierTrials:
    """Go through the trials of a run once more, without moving anything.

    A strategy is a state machine without clock, files or chance: fed with the recorded trials and the
    networks that there were, it is where it was. What it plans on the way has to be what was done.

    ``bags``: its whole trials, in order; None: all that have a name of their own.

    Raises:
        BagError: a bag cannot be used, or is not of the trial that the strategy plans there.
        InputFileError: the summary tells of a trial other things than bag and strategy do.
        NetworkFileError: the network after an earlier trial is missing or not whole.
        TrainingError: a trial that was completed cannot be learned from.
    """
    network = RecordedNetwork(folder, config)
    paths = load_path(config.path, config.arm), load_known_path(config.path, config.arm)
    session = PracticeSession(config, *paths, make_strategy(config), None, network)
    summarised = read_summary(folder)["trials"] if (folder / SUMMARY_FILE).exists() else ()
    stored = {int(row["index"]): row for row in summarised}
    rows: list[TrialRow] = []
    for bag in trial_bags(folder) if bags is None else bags:
        decision, report = session.next(), read_report(bag)
        plan = _as_planned(bag, decision, report)
        found = stored.get(plan.index)
        network.row = None if found is None else TrialRow.from_plain(found)
        if found is not None:
            _require_same_row(folder, TrialRow.of(PractisedTrial(plan, report, bag, None), bag.name), found)
        done = session.replay_trial(plan, report, bag)
        rows.append(TrialRow.of(done, bag.name, network.row.wall_s if network.row else math.nan))
    return EarlierTrials(session, tuple(rows), network.after)


def _as_planned(bag: Path, decision: PlannedTrial | Ending, report: TrialReport) -> PlannedTrial:
    if isinstance(decision, Ending):
        found = f"is trial {report.index}, but the strategy ends before it ({decision.message})"
        raise BagError(bag, found, _AS_BEGUN)
    for what, recorded, planned in (
        ("trial", report.index, decision.index),
        ("α", report.alpha, decision.alpha),
    ):
        if recorded != planned:
            found = f"has {what} {recorded}, but the strategy plans {what} {planned} there"
            raise BagError(bag, found, _AS_BEGUN)
    return decision


def _require_same_row(folder: Path, row: TrialRow, stored: Mapping[str, Any]) -> None:
    values: dict[str, Any] = json.loads(json.dumps(json_ready(row.to_plain())))
    for key, value in values.items():
        if key not in _NOT_RECORDED and stored.get(key) != value:
            found = f"tells of trial {row.index} that {key} is {stored.get(key)!r}"
            raise InputFileError(folder / SUMMARY_FILE, found, f"{value!r}, as bag and strategy tell")


@dataclass(frozen=True)
class Resumption:
    """What a resumed run goes on from: number of whole trials; what was set aside (new place), and why."""

    trials: int
    set_aside: dict[Path, str]


def resumed_config(folder: Path) -> Config:
    """Return the configuration of a run that is to go on; InputFileError if there is none."""
    if not (folder / CONFIG_FILE).is_file():
        found = f"has no {CONFIG_FILE}" if folder.is_dir() else missing(folder, "folder")
        raise InputFileError(folder, found, "the folder of a practice run")
    return load_config(folder / CONFIG_FILE)


def prepare_to_resume(folder: Path, config: Config) -> Resumption:
    """Bring the folder of an interrupted run in order. No node of it may be running.

    What cannot be gone on from (a bag that was never closed, a trial that was cancelled, a last bag that is
    damaged, the logs) is moved to ``set_aside/``, never deleted. A trial that was recorded but not learned
    from to the end is learned from again.

    Raises:
        InputFileError: the run is finished, or its files do not fit together; nothing was moved.
    """
    bags, cut_off = _whole_bags(folder)
    earlier = earlier_trials(folder, config, bags)
    if (folder / SUMMARY_FILE).exists():
        summary = read_summary(folder)
        if summary.get("outcome") in _ENDED and isinstance(earlier.session.next(), Ending):
            found = f"the run is finished: {summary['outcome']}, {counted(len(bags), 'trial')}"
            raise InputFileError(folder, found, "a run that was interrupted")
    leftovers = cut_off | dict.fromkeys(sorted((folder / UNFINISHED).glob("*")), "was never closed")
    if (folder / LOG_FOLDER).is_dir():
        leftovers[folder / LOG_FOLDER] = "logs of before"
    moved = {_set_aside(folder, path): why for path, why in leftovers.items()}
    if not any((folder / UNFINISHED).glob("*")) and (folder / UNFINISHED).is_dir():
        (folder / UNFINISHED).rmdir()
    if earlier.rows:
        publish_network(folder, earlier.network_after)
    again = RunSummary(folder, written_config(folder))
    again.rows = list(earlier.rows)
    again.write()
    return Resumption(len(bags), moved)


def _whole_bags(folder: Path) -> tuple[list[Path], dict[Path, str]]:
    """Return the bags to go on from, and the last one if it is none of them, with the reason."""
    bags, cut_off = trial_bags(folder), {}
    if bags and (why_not := _why_not(bags[-1])):
        cut_off[bags.pop()] = why_not
    require_all_before_last(folder, bags)
    for bag in bags:
        if why_not := _why_not(bag):
            raise BagError(bag, why_not, "a whole trial: another one follows")
    return bags, cut_off


def _why_not(bag: Path) -> str:
    """Return why a run cannot go on from a trial; empty: it can."""
    try:
        report = read_report(bag)
    except BagError as error:
        return error.found
    if report.outcome in (Outcome.CANCELLED, Outcome.REFUSED):
        return f"was {report.outcome.text}"
    return ""


def _set_aside(folder: Path, path: Path) -> Path:
    """Move something aside under a name that is free, and return its new place."""
    target, n = folder / SET_ASIDE / path.name, 1
    target.parent.mkdir(exist_ok=True)
    while target.exists():
        n += 1
        target = folder / SET_ASIDE / f"{path.name}.{n}"
    return path.rename(target)
