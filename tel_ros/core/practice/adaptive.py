"""Trajectory extension that chooses its own steps: a continuation method with step-size control."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tel_ros.core.config import ArmConfig, PracticeConfig
from tel_ros.core.control.records import Outcome, TrialReport
from tel_ros.core.practice.decisions import Ending, Forecaster, Movement, PlannedTrial
from tel_ros.core.practice.effort_limit import EffortLimit

_BISECTIONS = 6
_SLOWER_AFTER_ABORT = math.sqrt(2.0)
"""Torques go with 1/T²: a duration longer by this factor halves what pushes the arm off its path."""
_PATIENCE = 3
"""Trials at one speed without progress after which practice ends."""
_PROGRESS = 0.9
"""An error that falls below this share of the best one so far is progress."""
_FIRST_STEP = math.log(1.5)
_LARGER = 2.0
"""A step may be this much larger than the one before it."""
_LEAST_LIMIT = math.log(1.1)
"""So that one cautious step does not make all that follow it small."""
_OUTLOOK_RATIO = 0.75
_SAME_SPEED = 1.01
_MOST_OPTIMISTIC = 0.3


@dataclass(frozen=True)
class _Good:
    """A trial that is worth going back to."""

    index: int
    duration_s: float


class AdaptiveExtension:
    """Takes the largest step in speed after which the error should stay within a tolerance.

    What to expect of a speed comes from two sources: the learner's own standard deviation along the movement,
    and how earlier trials came out in proportion to it. A trial that came out worse than the tolerance of a
    step is repeated, and the next step is halved. After an abort the network of the last good trial is taken
    up again, at its speed or slower. Practice ends when the goal speed is reached within the
    tolerance of the goal, or when something stands in the way: the effort limits, errors that do not
    fall any more, or the number of trials.

    Args:
        practice: durations, tolerances, most trials.
        arm: effort limits.
        corridor_rad: deviation at which a trial is aborted.
    """

    def __init__(self, practice: PracticeConfig, arm: ArmConfig, corridor_rad: float) -> None:
        self._practice = practice
        self._corridor_rad = corridor_rad
        self._safe_s = practice.first_duration_s
        """Slow enough to stay well inside the corridor even with nothing learned."""
        self._effort = EffortLimit(arm)
        self._plan: PlannedTrial | None = None
        self._expected_std = math.inf
        self._ratio = 1.0
        """Tracking errors in proportion to the learner's standard deviation, as they came."""
        self._largest_step = _FIRST_STEP
        """In the logarithm of the duration."""
        self._good: list[_Good] = []
        self._best = math.inf
        self._without_progress = 0
        self._repeated_once = False

    def outlook(self) -> Sequence[Movement]:
        """Return the movements that are still to come if every step is about a quarter of the duration."""
        goal_s = self._practice.goal_duration_s
        if self._plan is None:
            duration_s, durations_s = self._practice.first_duration_s, [self._practice.first_duration_s]
        else:
            duration_s, durations_s = self._plan.movement.duration_s, []
        while duration_s > goal_s:
            duration_s = max(goal_s, duration_s * _OUTLOOK_RATIO)
            durations_s.append(duration_s)
        return [Movement(duration_s) for duration_s in durations_s]

    def next(self, last: TrialReport | None, forecast: Forecaster) -> PlannedTrial | Ending:
        """Return the next trial, or the end of practice and its reason."""
        if last is None or self._plan is None:
            return self._planned(self._practice.first_duration_s, forecast, "the first trial")
        if last.outcome == Outcome.CANCELLED:
            return Ending("cancelled", "the run was cancelled")
        if last.outcome == Outcome.COMPLETED:
            decision = self._after_success(last, forecast)
        else:
            decision = self._after_abort(last, forecast)
        if isinstance(decision, PlannedTrial) and decision.index > self._practice.trials:
            return Ending(
                "aborted" if last.outcome == Outcome.ABORTED else "stopped",
                f"{self._goal} was not reached within {self._practice.trials} trials: the last one had "
                f"{_mrad(last.rms_error_rad)} RMS at {last.duration_s:.3f} s",
            )
        return decision

    @property
    def _goal(self) -> str:
        return f"{self._practice.goal_duration_s:g} s within {_mrad(self._practice.tolerance_rad)}"

    def _after_success(self, last: TrialReport, forecast: Forecaster) -> PlannedTrial | Ending:
        practice, error_rad = self._practice, last.rms_error_rad
        assert self._plan is not None
        duration_s = self._plan.movement.duration_s
        self._learn_ratio(error_rad)
        if last.index == 1:
            # Without a network the deviation is what the torques make it, and these go with 1/T².
            self._safe_s = duration_s * math.sqrt(last.max_error_rad / (0.5 * self._corridor_rad))
        self._effort.learn(duration_s, forecast)
        fastest_s = self._effort.fastest_s(practice.goal_duration_s, duration_s)
        at_the_end = duration_s <= fastest_s * _SAME_SPEED
        tolerance_rad = practice.tolerance_rad if at_the_end else practice.step_tolerance_rad
        if error_rad > tolerance_rad and last.index > 1:
            return self._repeated(last, forecast, fastest_s)
        if self._good and self._good[-1].duration_s > duration_s:
            step = math.log(self._good[-1].duration_s / duration_s)
            self._largest_step = max(step if self._repeated_once else _LARGER * step, _LEAST_LIMIT)
        self._good.append(_Good(last.index, duration_s))
        self._best, self._without_progress, self._repeated_once = math.inf, 0, False
        if at_the_end and error_rad <= tolerance_rad:
            if fastest_s <= practice.goal_duration_s:
                return Ending(
                    "completed",
                    f"{practice.goal_duration_s:g} s reached with {_mrad(error_rad)} RMS "
                    f"after {last.index} trials",
                )
            return Ending("stopped", self._limited(last, fastest_s))
        return self._extended(duration_s, fastest_s, forecast)

    def _limited(self, last: TrialReport, fastest_s: float) -> str:
        goal_s = self._practice.goal_duration_s
        return (
            f"{goal_s:g} s cannot be reached: {self._effort.needed_text(goal_s)}; about {fastest_s:.2f} s is "
            f"the fastest that the effort limits allow, and {last.duration_s:.3f} s was reached with "
            f"{_mrad(last.rms_error_rad)} RMS after {last.index} trials"
        )

    def _repeated(self, last: TrialReport, forecast: Forecaster, fastest_s: float) -> PlannedTrial | Ending:
        assert self._plan is not None
        duration_s = self._plan.movement.duration_s
        if last.rms_error_rad < _PROGRESS * self._best:
            self._best, self._without_progress = last.rms_error_rad, 0
        else:
            self._without_progress += 1
        if self._without_progress >= _PATIENCE:
            return Ending(
                "stopped",
                f"{self._goal} was not reached: the error stays at {_mrad(self._best)} RMS at "
                f"{duration_s:.3f} s, and {_PATIENCE} more trials have not lowered it",
            )
        self._repeated_once = True
        reason = f"repeated: {_mrad(last.rms_error_rad)} RMS were more than wanted"
        return self._planned(duration_s, forecast, reason)

    def _extended(self, duration_s: float, fastest_s: float, forecast: Forecaster) -> PlannedTrial:
        """Return the largest step after which the error should stay within the tolerance of a step."""
        low = max(fastest_s, duration_s * math.exp(-self._largest_step))
        wanted_rad = self._practice.step_tolerance_rad
        reason = "as far as the errors should stay small"
        if self._expected_rms(low, forecast) <= wanted_rad:
            if low > fastest_s:
                reason = "the largest step that is allowed"
            elif fastest_s > self._practice.goal_duration_s:
                reason = f"the fastest that the effort limits allow, about {fastest_s:.2f} s"
            else:
                reason = "the goal"
            return self._planned(low, forecast, reason)
        high = duration_s
        for _ in range(_BISECTIONS):
            middle = math.sqrt(low * high)
            if self._expected_rms(middle, forecast) <= wanted_rad:
                high = middle
            else:
                low = middle
        if high == duration_s:
            reason = "repeated: no faster one is known well enough"
        return self._planned(high, forecast, reason)

    def _after_abort(self, last: TrialReport, forecast: Forecaster) -> PlannedTrial | Ending:
        assert self._plan is not None
        failed_s = self._plan.movement.duration_s
        # Small errors were expected, or it would not have been tried. So the arm is not what it was believed
        # to be, and what was learned may be worth nothing: slow enough means slow enough without it.
        slow_s = max(failed_s * _SLOWER_AFTER_ABORT, self._safe_s)
        known_s = [good.duration_s for good in self._good if good.duration_s > failed_s]
        while self._good and self._good[-1].duration_s <= failed_s:
            self._good.pop()  # it has failed at a speed that was good once
        if known_s:
            self._largest_step = max(0.5 * math.log(known_s[-1] / failed_s), _LEAST_LIMIT)
        back_to = self._good[-1].index if self._good else 0
        self._best, self._without_progress, self._repeated_once = math.inf, 0, False
        return self._planned(
            max([slow_s, *known_s[-1:]]),
            forecast,
            f"back after the abort of trial {last.index}",
            go_back_to=back_to,
        )

    def _planned(
        self, duration_s: float, forecast: Forecaster, reason: str, go_back_to: int | None = None
    ) -> PlannedTrial:
        index = self._plan.index + 1 if self._plan else 1
        movement = Movement(duration_s)
        # After going back the forecast would be that of the network that is left.
        self._expected_std = math.inf if go_back_to is not None else _rms(forecast(movement).std_rad)
        expected_rad = self._ratio * self._expected_std
        self._plan = PlannedTrial(
            index=index,
            alpha=self._practice.goal_duration_s / duration_s,
            movement=movement,
            go_back_to=go_back_to,
            reason=reason,
            expected_rms_rad=expected_rad if math.isfinite(expected_rad) else math.nan,
        )
        return self._plan

    def _learn_ratio(self, error_rad: float) -> None:
        """Learn from how the last trial came out in proportion to what the learner expected."""
        if not (math.isfinite(self._expected_std) and self._expected_std > 0.0):
            return
        found = error_rad / self._expected_std
        # Bad news count at once, good news by and by.
        self._ratio = max(found, math.sqrt(found * self._ratio), _MOST_OPTIMISTIC)

    def _expected_rms(self, duration_s: float, forecast: Forecaster) -> float:
        return self._ratio * _rms(forecast(Movement(duration_s)).std_rad)


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _mrad(error_rad: float) -> str:
    return f"{1e3 * error_rad:.2f} mrad"
