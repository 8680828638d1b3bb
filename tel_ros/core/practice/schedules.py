"""Strategies whose movements are known beforehand."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tel_ros.core.config import PracticeConfig
from tel_ros.core.practice.course import Course, Leg
from tel_ros.core.practice.decisions import Ending, Forecaster, Movement, PlannedTrial
from tel_ros.core.trial import Outcome, TrialReport
from tel_ros.core.types import FloatArray


class FixedSchedule:
    """Trial after trial of a list, whatever comes out.

    Args:
        movements: of the trials, in order.
        course: says what their α is.
        stop_on_abort: whether a trial that was not completed ends the run.
    """

    def __init__(self, movements: Sequence[Movement], course: Course, stop_on_abort: bool) -> None:
        self._movements = list(movements)
        self._course = course
        self._stop_on_abort = stop_on_abort
        self._done = 0

    def preview(self) -> Sequence[Movement]:
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
        return PlannedTrial(self._done, self._course.alpha(movement), movement)


def trajectory_extension(config: PracticeConfig) -> FixedSchedule:
    """Go step by step from the first movement to the goal ([Practice] Sec. 2.2 and 3).

    The speed goes up in even steps of duration T as in the paper, of speed 1/T, or of the torque that the
    movement needs, 1/T²; or through a list of durations. Whatever else varies goes in even steps of its
    logarithm, the shape in even steps (see :class:`~.course.Leg`). The trials are spread evenly over all that
    varies.
    """
    course, stop_on_abort = Course.configured(config), config.on_abort == "stop"
    if config.durations_s:
        movements = [course.at_duration(duration_s) for duration_s in config.durations_s]
        return FixedSchedule(movements, course, stop_on_abort)
    movements = []
    shares = np.array_split(np.arange(config.trials), len(course.legs))
    for leg, trials in zip(course.legs, shares, strict=True):
        # Where a leg begins is where the one before it has ended.
        n_points = len(trials) + bool(movements)
        movements += [
            course.on_leg(leg, float(value))
            for value in _even_steps(leg, n_points, config.spacing)[bool(movements) :]
        ]
    return FixedSchedule(movements, course, stop_on_abort)


def direct(config: PracticeConfig) -> FixedSchedule:
    """Practise the goal from the start: the control condition of [Practice] Sec. 3."""
    goal = Movement(config.goal_duration_s)
    return FixedSchedule([goal] * config.trials, Course.configured(config), config.on_abort == "stop")


def _even_steps(leg: Leg, n: int, spacing: str) -> FloatArray:
    """Return values of what varies on a leg from its first to its goal. Shape (n,)."""
    if leg.varied == "speed":
        power = {"duration": 1.0, "speed": -1.0, "torque": -2.0}[spacing]
        steps = np.linspace(leg.first**power, leg.goal**power, n)
        values: FloatArray = steps ** (1.0 / power)
    else:
        eases = np.exp(np.linspace(np.log(leg.first_ease), np.log(leg.goal_ease), n))
        values = np.array([leg.value(float(ease)) for ease in eases])
    values[-1] = leg.goal  # free of rounding: the last movement of a leg is the one that was asked for
    return values
