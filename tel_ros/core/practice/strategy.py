"""Practice strategies: the sequence of movements that leads to the one that is wanted."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from tel_ros.core.config import PracticeConfig
from tel_ros.core.control.records import Outcome, TrialReport
from tel_ros.core.types import FloatArray


@dataclass(frozen=True)
class PlannedTrial:
    """What to try next.

    Args:
        index: number of the trial, from 1.
        alpha: practice parameter: speed as a fraction of the goal speed, α_d = 1 ([Practice] A5).
        duration_s: duration of the desired trajectory.
    """

    index: int
    alpha: float
    duration_s: float


class Strategy(Protocol):
    """Decides after each trial what to do next."""

    @property
    def planned_durations_s(self) -> FloatArray:
        """Durations of all trials of the run, past ones included, if nothing goes wrong. Shape (n,)."""

    def next(self, last: TrialReport | None) -> PlannedTrial | None:
        """Return the next trial, or None when practice is over.

        Args:
            last: the trial that has just ended; None at the beginning.
        """


class FixedSchedule:
    """A strategy that knows its durations beforehand.

    Args:
        durations_s: of the trials, in order. Shape (n,).
        goal_duration_s: the duration that is α = 1.
        stop_on_abort: whether a trial that was not completed ends the run.
    """

    def __init__(self, durations_s: FloatArray, goal_duration_s: float, stop_on_abort: bool) -> None:
        self._durations_s = durations_s
        self._goal_duration_s = goal_duration_s
        self._stop_on_abort = stop_on_abort
        self._done = 0

    @property
    def planned_durations_s(self) -> FloatArray:
        """Durations of all trials of the run, past ones included, if nothing goes wrong. Shape (n,)."""
        return self._durations_s

    def next(self, last: TrialReport | None) -> PlannedTrial | None:
        """Return the next trial of the schedule, or None at its end or after a trial that ends the run."""
        if last is not None and last.outcome == Outcome.CANCELLED:
            return None
        if last is not None and last.outcome == Outcome.ABORTED and self._stop_on_abort:
            return None
        if self._done == len(self._durations_s):
            return None
        duration_s = float(self._durations_s[self._done])
        self._done += 1
        return PlannedTrial(self._done, self._goal_duration_s / duration_s, duration_s)


def trajectory_extension(config: PracticeConfig) -> FixedSchedule:
    """Raise the speed in even steps from the first to the goal duration ([Practice] Sec. 2.2 and 3).

    Even in duration T as in the paper, in speed 1/T, or in the torque that the movement needs, 1/T².
    """
    power = {"duration": 1.0, "speed": -1.0, "torque": -2.0}[config.spacing]
    steps = np.linspace(config.first_duration_s**power, config.goal_duration_s**power, config.trials)
    durations_s = steps ** (1.0 / power)
    durations_s[-1] = config.goal_duration_s  # free of rounding: the last trial is the one that was asked for
    return FixedSchedule(durations_s, config.goal_duration_s, config.on_abort == "stop")


def direct(config: PracticeConfig) -> FixedSchedule:
    """Practise at the goal speed from the start: the control condition of [Practice] Sec. 3."""
    durations_s = np.full(config.trials, config.goal_duration_s)
    return FixedSchedule(durations_s, config.goal_duration_s, config.on_abort == "stop")


STRATEGIES = {"trajectory_extension": trajectory_extension, "direct": direct}


def make_strategy(config: PracticeConfig) -> Strategy:
    """Return the configured strategy."""
    return STRATEGIES[config.strategy](config)
