"""Strategies whose movements are known beforehand."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tel_ros.core.config import PracticeConfig
from tel_ros.core.control.records import Outcome, TrialReport
from tel_ros.core.practice.decisions import Ending, Forecaster, Movement, PlannedTrial
from tel_ros.core.types import FloatArray


class FixedSchedule:
    """Trial after trial of a list, whatever comes out.

    Args:
        durations_s: of the trials, in order. Shape (n,).
        goal_duration_s: the duration that is α = 1.
        stop_on_abort: whether a trial that was not completed ends the run.
    """

    def __init__(
        self, durations_s: FloatArray | Sequence[float], goal_duration_s: float, stop_on_abort: bool
    ) -> None:
        self._movements = [Movement(float(duration_s)) for duration_s in durations_s]
        self._goal_duration_s = goal_duration_s
        self._stop_on_abort = stop_on_abort
        self._done = 0

    def outlook(self) -> Sequence[Movement]:
        """Return the movements that are still to come."""
        return self._movements[self._done :]

    def next(self, last: TrialReport | None, forecast: Forecaster) -> PlannedTrial | Ending:
        """Return the next trial of the schedule, or the end after the last one or one that ends the run."""
        if last is not None and last.outcome == Outcome.CANCELLED:
            return Ending("cancelled", "the run was cancelled")
        over = self._done == len(self._movements)
        if last is not None and last.outcome == Outcome.ABORTED and (self._stop_on_abort or over):
            return Ending("aborted", f"trial {last.index} was aborted: {last.message}")
        if over:
            return Ending("completed")
        movement = self._movements[self._done]
        self._done += 1
        return PlannedTrial(self._done, self._goal_duration_s / movement.duration_s, movement)


def trajectory_extension(config: PracticeConfig) -> FixedSchedule:
    """Raise the speed step by step from the first to the goal duration ([Practice] Sec. 2.2 and 3).

    In even steps of duration T as in the paper, of speed 1/T, or of the torque that the movement needs,
    1/T²; or through a list of durations.
    """
    stop_on_abort = config.on_abort == "stop"
    if config.durations_s:
        return FixedSchedule(config.durations_s, config.goal_duration_s, stop_on_abort)
    power = {"duration": 1.0, "speed": -1.0, "torque": -2.0}[config.spacing]
    steps = np.linspace(config.first_duration_s**power, config.goal_duration_s**power, config.trials)
    durations_s = steps ** (1.0 / power)
    durations_s[-1] = config.goal_duration_s  # free of rounding: the last trial is the one that was asked for
    return FixedSchedule(durations_s, config.goal_duration_s, stop_on_abort)


def direct(config: PracticeConfig) -> FixedSchedule:
    """Practise at the goal speed from the start: the control condition of [Practice] Sec. 3."""
    durations_s = np.full(config.trials, config.goal_duration_s)
    return FixedSchedule(durations_s, config.goal_duration_s, config.on_abort == "stop")
