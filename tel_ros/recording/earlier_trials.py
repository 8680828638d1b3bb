"""What a practice run had done before it was interrupted.

A strategy is a state machine without clock, files or chance: fed once more with what came out of the trials,
and with forecasts of the networks that there were, it is where it was. What it plans on the way has to be
what was done.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from tel_ros.core.config import Config
from tel_ros.core.errors import BagError, InputFileError
from tel_ros.core.learning.inputs import query_inputs
from tel_ros.core.learning.learner import Learner, std_along
from tel_ros.core.practice.decisions import Ending, Forecast, Movement, PlannedTrial
from tel_ros.core.practice.forecast import forecast_of, forecast_trajectory
from tel_ros.core.practice.lock_up import LockUpMonitor
from tel_ros.core.practice.strategy import make_strategy
from tel_ros.core.trial import Outcome, TrialReport
from tel_ros.recording.network_file import load_network, save_network
from tel_ros.recording.retraining import learned_from
from tel_ros.recording.run_folder import (
    NETWORK_FILE,
    SUMMARY_FILE,
    json_ready,
    network_after,
    read_summary,
    trial_bags,
)
from tel_ros.recording.run_state import RunState
from tel_ros.recording.summary import TrialRow
from tel_ros.recording.trial_bag import read_trial
from tel_ros.recording.trial_report import read_report
from tel_ros.recording.waypoint_file import load_known_path, load_path

_LEARNED = ("training_rms_before_rad", "training_rms_after_rad", "rms_command_change_rad", "grown")
"""Columns of a row that tell what was learned."""
_NOT_RECORDED = (*_LEARNED, "warning", "wall_s")
"""Columns that neither the plan nor the bag tells."""

_AS_BEGUN = "the bags, the configuration and the version that the run was begun with"


class NetworkForecast:
    """Answers a strategy's questions from the file of a network, as the service *predict* does.

    Args:
        folder: of the run.
        config: of the run.
    """

    def __init__(self, folder: Path, config: Config) -> None:
        self._folder, self._config = folder, config
        self._path = load_path(config.path, config.arm)
        self._known_path = load_known_path(config.path, config.arm)
        self._loaded: tuple[int, Learner] | None = None
        self.after = 0
        """The trial whose network is asked."""

    def learner(self) -> Learner:
        """Return the network as it was then.

        Raises:
            NetworkFileError: its file is missing or not whole.
        """
        if self._loaded is None or self._loaded[0] != self.after:
            self._loaded = (self.after, load_network(network_after(self._folder, self.after)))
        return self._loaded[1]

    def __call__(self, movement: Movement) -> Forecast:
        """Return what the network expects of a movement."""
        learner, arm = self.learner(), self._config.arm
        desired = forecast_trajectory(self._path, self._known_path, movement)
        inputs = query_inputs(desired, 1.0 / self._config.control.rate_hz)
        # The service answers with equilibrium points, and the rounding of that has its share in decisions.
        equilibrium_rad = desired.position_rad + learner.predict(inputs)
        offset_rad = equilibrium_rad - desired.position_rad
        return forecast_of(desired, offset_rad, std_along(learner, inputs), arm, movement)


def earlier_trials(folder: Path, config: Config, bags: Sequence[Path] | None = None) -> RunState:
    """Go through the trials of a run once more, without moving anything.

    A trial that was recorded but not learned from to the end is learned from again, and the network saved.

    Args:
        folder: of the run.
        config: of the run, with absolute file names.
        bags: its whole trials, in order; None: all that have a name of their own.

    Raises:
        BagError: a bag cannot be used, or is not of the trial that the strategy plans there.
        InputFileError: the summary tells of a trial other things than bag and strategy do.
        NetworkFileError: the network after an earlier trial is missing or not whole.
        TrainingError: a trial that was completed cannot be learned from.
    """
    bags = trial_bags(folder) if bags is None else bags
    stored = _stored_rows(folder)
    strategy, last = make_strategy(config), None
    lock_up = LockUpMonitor(config.practice.tolerance_rad)
    forecast = NetworkForecast(folder, config)
    rows: list[TrialRow] = []
    for bag in bags:
        decision = strategy.next(last, forecast)
        last = read_report(bag)
        plan = _as_planned(bag, decision, last)
        if plan.go_back_to is not None:
            forecast.after = plan.go_back_to
        row = TrialRow(plan=plan, report=last, bag=bag.name, wall_s=math.nan)
        found = stored.get(plan.index)
        if found is not None:
            _require_same_row(folder, row, found)
            _take_over(row, found)
        if found is None or (_taught(row) and not network_after(folder, plan.index).is_file()):
            _learn_again(row, bag, folder, config, forecast)
        if _taught(row):
            forecast.after = plan.index
            row.warning = lock_up.after_trial(
                plan.alpha, last.rms_error_rad, row.training_rms_before_rad, row.training_rms_after_rad
            )
        rows.append(row)
    network = network_after(folder, forecast.after) if rows else None
    return RunState(strategy, lock_up, tuple(rows), last, network, forecast)


def _stored_rows(folder: Path) -> dict[int, dict[str, Any]]:
    """Return the rows of the summary by trial; none if the run was interrupted before there was any."""
    if not (folder / SUMMARY_FILE).exists():
        return {}
    return {int(row["index"]): row for row in read_summary(folder)["trials"]}


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
    values: dict[str, Any] = json.loads(json.dumps(json_ready(row.as_dict())))
    for key, value in values.items():
        if key not in _NOT_RECORDED and stored.get(key) != value:
            found = f"tells of trial {row.plan.index} that {key} is {stored.get(key)!r}"
            raise InputFileError(folder / SUMMARY_FILE, found, f"{value!r}, as bag and strategy tell")


def _take_over(row: TrialRow, stored: Mapping[str, Any]) -> None:
    for key in ("training_rms_before_rad", "training_rms_after_rad", "rms_command_change_rad", "wall_s"):
        value = stored.get(key)
        setattr(row, key, math.nan if value is None else float(value))
    row.grown = list(stored.get("grown", ()))


def _taught(row: TrialRow) -> bool:
    return math.isfinite(row.training_rms_after_rad)


def _learn_again(row: TrialRow, bag: Path, folder: Path, config: Config, before: NetworkForecast) -> None:
    """Learn from a trial whose lesson was interrupted, with the network as it was before."""
    network, training, _ = learned_from(read_trial(bag), config, before.learner())
    if training is not None:
        row.training_rms_before_rad = training.rms_before_rad
        row.training_rms_after_rad = training.rms_after_rad
        row.rms_command_change_rad = training.rms_command_change_rad
        row.grown = list(training.grown)
    elif row.report.outcome != Outcome.COMPLETED:
        return
    for file in (network_after(folder, row.plan.index), folder / NETWORK_FILE):
        save_network(network, file)
