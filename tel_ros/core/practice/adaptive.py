"""Trajectory extension that chooses its own steps: a continuation method with step-size control."""

from __future__ import annotations

import math
from collections.abc import Sequence

from tel_ros.core.config import Config
from tel_ros.core.errors import counted
from tel_ros.core.learning.learner import rms
from tel_ros.core.practice.course import Course
from tel_ros.core.practice.feasibility import EffortLimit
from tel_ros.core.practice.strategy import Ending, Forecast, Forecaster, Movement, PlannedTrial
from tel_ros.core.trial import Outcome, TrialReport

_BISECTIONS = 6
_SLOWER_AFTER_ABORT = math.sqrt(2.0)
"""Torques go with 1/T²: a slowness greater by this factor halves what pushes the arm off its path."""
_PATIENCE = 3
"""Trials of one movement without progress after which practice ends."""
_PROGRESS = 0.9
"""An error that falls below this share of the best one so far is progress."""
ANOTHER_ARM = 2.0
"""An error above this multiple of the best one at the same movement is that of an arm that has changed."""
_FIRST_STEP = math.log(1.5)
_LARGER = 2.0
"""A step may be this much larger than the one before it."""
_LEAST_LIMIT = math.log(1.1)
"""So that one cautious step does not make all that follow it small."""
_PREVIEW_RATIO = 0.75
_SAME_SLOWNESS = 1.01
_MOST_OPTIMISTIC = 0.3


class AdaptiveExtension:
    """Takes the largest step along its course after which the error should stay within a tolerance.

    Movements are ordered by their slowness, which is the duration if only the speed varies (see
    :class:`~.course.Course`). The error to expect is the learner's own standard deviation along a movement,
    times the ratio of error to standard deviation in earlier trials. A trial worse than the tolerance of a
    step is repeated, and the next step is halved. After an abort practice goes back to the network of the
    last good trial, for its movement or a slower one. Practice ends when the goal is reached within its
    tolerance, or cannot be reached: effort limits, errors that stop falling, or the number of trials.

    It goes the configured course, unless another one is given. The network is as it was after the trial
    before ``first_index``. ``first_slowness``: None: that of the course.
    """

    def __init__(
        self,
        config: Config,
        course: Course | None = None,
        first_index: int = 1,
        first_slowness: float | None = None,
    ) -> None:
        self._practice = config.practice
        self._path_tolerance_rad = config.control.path_tolerance_rad
        self._course = course or Course.configured(config.practice)
        self._first_index = first_index
        self._safe_slowness = self._course.first_slowness
        """Easy enough to stay well inside the path tolerance even with nothing learned."""
        self._slowness = self._course.first_slowness if first_slowness is None else first_slowness
        """Of the trial that is planned, or will be as the first."""
        self._effort = EffortLimit(config.arm, self._course.at_duration)
        self._plan: PlannedTrial | None = None
        self._expected_std = math.inf
        self._began_unlearned = False
        self._ratio = 1.0
        """Tracking errors in proportion to the learner's standard deviation, as they came."""
        self._largest_step = _FIRST_STEP
        """In the logarithm of the slowness."""
        self._good: list[tuple[int, float]] = []
        """Number and slowness of the trials that are worth going back to."""
        self._begin_movement()

    def preview(self) -> Sequence[Movement]:
        """Return the movements still to come if every step takes about a quarter off the slowness.

        Before the first trial they lead to the goal, afterwards there are at most as many as trials left.
        """
        slowness, goal = self._slowness, self._course.goal_slowness
        slownesses = [slowness] if self._plan is None else []
        while slowness > goal:
            slowness = max(goal, slowness * _PREVIEW_RATIO)
            slownesses.append(slowness)
        return [self._course.movement(slowness) for slowness in slownesses[: self.trials_left]]

    def movements_to_cover(self) -> Sequence[Movement]:
        """Return the movements that bound the course."""
        return self._course.to_cover

    def fastest_movements(self) -> Sequence[Movement]:
        """Return the movements at both ends of each leg of the course."""
        return self._course.ends

    @property
    def trials_left(self) -> int | None:
        """Number of trials that may follow the planned one; None before one is planned."""
        return None if self._plan is None else max(0, self._practice.trials - self._plan.index)

    def next(self, last: TrialReport | None, forecast: Forecaster) -> PlannedTrial | Ending:
        """Return the next trial, or the end of practice and its reason."""
        if last is None or self._plan is None:
            plan = self._planned(self._slowness, forecast, "the first trial")
            self._began_unlearned = math.isinf(self._expected_std)
            return plan
        if last.outcome == Outcome.CANCELLED:
            return Ending("cancelled", "the run was cancelled")
        self._effort.heed(last.given_nm)
        if last.outcome == Outcome.COMPLETED:
            decision = self._after_success(last, forecast)
        else:
            decision = self._after_abort(last, forecast)
        if isinstance(decision, PlannedTrial) and decision.index > self._practice.trials:
            aborted = last.outcome == Outcome.ABORTED
            how = f"was aborted: {last.message}" if aborted else f"had {_mrad(last.rms_error_rad)} RMS"
            short = f" ({last.message})" if last.message and not aborted else ""
            at_goal = self._slowness <= self._course.goal_slowness
            easier = "" if at_goal else ", which is easier,"
            return Ending(
                "aborted" if aborted else "stopped",
                f"{self._goal} was not reached within {counted(self._practice.trials, 'trial')}: the last "
                f"one was at {self._reached(last)}{easier} and {how}{short}",
            )
        return decision

    def _reached(self, last: TrialReport) -> str:
        assert self._plan is not None
        movement = self._plan.movement
        # The desired trajectory of a whole movement ends at a tick, which can be a little later.
        return self._course.text(movement, f"{last.duration_s:.3f} s" if movement.is_whole else "")

    @property
    def _goal(self) -> str:
        return f"{self._course.goal_text} within {_mrad(self._practice.tolerance_rad)}"

    def _after_success(self, last: TrialReport, forecast: Forecaster) -> PlannedTrial | Ending:
        error_rad, slowness = last.rms_error_rad, self._slowness
        if math.isfinite(self._expected_std) and self._expected_std > 0.0:
            found = error_rad / self._expected_std
            # Bad news count at once, good news by and by.
            self._ratio = max(found, math.sqrt(found * self._ratio), _MOST_OPTIMISTIC)
        unlearned = self._began_unlearned and (
            last.index == 1 or (self._plan is not None and self._plan.go_back_to == 0)
        )
        if unlearned and self._course.deviates_with_slowness:
            # Without a network the deviation is what the torques make it, and these go with 1/T².
            self._safe_slowness = slowness * math.sqrt(last.max_error_rad / (0.5 * self._path_tolerance_rad))
        if self._course.varies_speed_at(slowness):
            self._effort.learn(self._course.movement(slowness).duration_s, forecast)
        hardest = self._hardest()
        at_goal = slowness <= self._course.goal_slowness
        # How fast the effort limits allow is foreseen a little differently after every trial.
        at_the_end = at_goal or (
            hardest > self._course.goal_slowness and slowness <= hardest * _SAME_SLOWNESS
        )
        practice = self._practice
        tolerance_rad = practice.tolerance_rad if at_the_end else practice.step_tolerance_rad
        if error_rad > tolerance_rad and not unlearned:
            return self._repeated(last, forecast)
        if self._good and self._good[-1][1] > slowness:
            step = math.log(self._good[-1][1] / slowness)
            self._largest_step = max(step if self._repeated_once else _LARGER * step, _LEAST_LIMIT)
        self._good.append((last.index, slowness))
        self._begin_movement()
        if at_the_end and error_rad <= tolerance_rad:
            if at_goal:
                reached = f"{self._course.goal_text} reached with {_mrad(error_rad)} RMS"
                return Ending("completed", f"{reached} after {counted(last.index, 'trial')}")
            return Ending(
                "stopped",
                f"{self._course.goal_text} cannot be reached: "
                f"{self._effort.needed_text(self._course.goal.duration_s)}; about "
                f"{self._course.movement(hardest).duration_s:.2f} s is the fastest that the effort limits "
                f"allow, and {self._reached(last)} was reached with {_mrad(error_rad)} RMS after "
                f"{counted(last.index, 'trial')}",
            )
        return self._extended(hardest, forecast)

    def _begin_movement(self) -> None:
        self._best, self._without_progress, self._repeated_once = math.inf, 0, False

    def _hardest(self) -> float:
        """Return the least slowness that the effort limits allow, as far as it is known."""
        course = self._course
        if not course.varies_speed_at(self._slowness):
            return course.goal_slowness
        goal_s = course.goal.duration_s
        fastest_s = self._effort.fastest_s(goal_s, course.movement(course.first_slowness).duration_s)
        return course.goal_slowness if fastest_s <= goal_s else course.slowness_at_duration(fastest_s)

    def _repeated(self, last: TrialReport, forecast: Forecaster) -> PlannedTrial | Ending:
        assert self._plan is not None
        hardest = self._hardest()
        if hardest > self._slowness * _SAME_SLOWNESS:
            self._best, self._without_progress = math.inf, 0
            fastest_s = self._course.movement(hardest).duration_s
            reason = f"slower: the effort limits allow about {fastest_s:.2f} s"
            return self._planned(hardest, forecast, reason)
        if last.rms_error_rad > ANOTHER_ARM * self._best:
            self._best = math.inf
        if last.rms_error_rad < _PROGRESS * self._best:
            self._best, self._without_progress = last.rms_error_rad, 0
        else:
            self._without_progress += 1
        if self._without_progress >= _PATIENCE:
            return Ending(
                "stopped",
                f"{self._goal} was not reached: the error stays at {_mrad(self._best)} RMS at "
                f"{self._course.text(self._plan.movement)}, and {_PATIENCE} more trials have not lowered it",
            )
        self._repeated_once = True
        reason = f"repeated: {_mrad(last.rms_error_rad)} RMS were more than wanted"
        return self._planned(self._slowness, forecast, reason)

    def _extended(self, hardest: float, forecast: Forecaster) -> PlannedTrial | Ending:
        """Return the largest step after which the error should stay within the tolerance of a step."""

        def is_easy(slowness: float) -> bool:
            return self._is_easy(forecast(self._course.movement(slowness)))

        low, high = max(hardest, self._slowness * math.exp(-self._largest_step)), self._slowness
        if is_easy(low):
            if low > hardest:
                reason = "the largest step that is allowed"
            elif hardest > self._course.goal_slowness:
                fastest_s = self._course.movement(hardest).duration_s
                reason = f"the fastest that the effort limits allow, about {fastest_s:.2f} s"
            else:
                reason = "the goal"
            return self._planned(low, forecast, reason)
        for _ in range(_BISECTIONS):
            middle = math.sqrt(low * high)
            low, high = (low, middle) if is_easy(middle) else (middle, high)
        reason = "as far as the errors should stay small"
        if high == self._slowness:
            reason = "repeated: no faster one is known well enough"
        return self._planned(high, forecast, reason)

    def _is_easy(self, forecast: Forecast) -> bool:
        """Return whether the error of a movement should stay within the tolerance of a step."""
        return self._ratio * rms(forecast.std_rad) <= self._practice.step_tolerance_rad

    def _after_abort(self, last: TrialReport, forecast: Forecaster) -> PlannedTrial | Ending:
        assert self._plan is not None
        failed = self._slowness
        # Small errors were expected, or it would not have been tried. So the arm is not what it was believed
        # to be, and what was learned may be worth nothing: easy enough means easy enough without it.
        easy = max(failed * _SLOWER_AFTER_ABORT, self._safe_slowness)
        known = [slowness for _, slowness in self._good if slowness > failed]
        while self._good and self._good[-1][1] <= failed:
            self._good.pop()  # a movement has failed that was good once
        if known:
            self._largest_step = max(0.5 * math.log(known[-1] / failed), _LEAST_LIMIT)
        easier = min(max([easy, *known[-1:]]), self._course.most_slowness)
        back_to = self._good[-1][0] if self._good else self._first_index - 1
        if easier <= failed and (self._plan.go_back_to == back_to or last.index == self._first_index):
            failure = f"trial {last.index} was aborted, and there is no easier movement"
            return Ending("aborted", f"{failure}: {last.message}")
        self._begin_movement()
        return self._planned(easier, forecast, f"back after the abort of trial {last.index}", back_to)

    def _planned(
        self, slowness: float, forecast: Forecaster, reason: str, go_back_to: int | None = None
    ) -> PlannedTrial:
        index = self._plan.index + 1 if self._plan else self._first_index
        movement = self._course.movement(slowness)
        self._slowness = slowness
        # After going back the forecast would be that of the network that is left.
        self._expected_std = math.inf if go_back_to is not None else rms(forecast(movement).std_rad)
        expected_rad = self._ratio * self._expected_std
        self._plan = PlannedTrial(
            index=index,
            alpha=self._course.alpha(movement),
            movement=movement,
            go_back_to=go_back_to,
            reason=reason,
            expected_rms_rad=expected_rad if math.isfinite(expected_rad) else math.nan,
        )
        return self._plan


def _mrad(error_rad: float) -> str:
    return f"{1e3 * error_rad:.2f} mrad"
