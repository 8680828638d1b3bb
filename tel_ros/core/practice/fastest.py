"""Practice towards the fastest movement that the arm's effort limits allow."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tel_ros.core.config import Config, PracticeConfig
from tel_ros.core.errors import TrajectoryError
from tel_ros.core.practice.adaptive import ANOTHER_ARM, AdaptiveExtension
from tel_ros.core.practice.course import Course, Leg
from tel_ros.core.practice.learned_timings import VELOCITY_SHARE
from tel_ros.core.practice.strategy import Ending, Forecast, Forecaster, Movement, PlannedTrial
from tel_ros.core.trial import Outcome, TrialReport

_SLOWER_THAN_OPTIMAL = 2.0
"""A minimum-jerk movement takes about this many times as long as a time-optimal one with the same efforts
(2.07 in the median over 60 random paths)."""
_FIRST_GUESS = 4.0
_LEAST_FIRST = 1.01
AT_THE_LIMIT = 0.97
"""Of what a joint may use: from here on it counts as what limits the movement."""
_HARDLY_FASTER = 1.005
"""Slownesses whose ratio is smaller than this are about the same."""
_STANDSTILLS = 3
"""Trials without a faster one to follow after which practice ends."""
_ERROR_EXPONENT = 4.0
"""Near the limits errors go with about this power of the speed."""
_EASED = (1.02, 1.15)
"""By how much the movement is made slower at once, at least and at most."""
_HARDLY_BETTER = 0.8
"""A repeat with an error above this share of the one before has hardly helped."""


class EffortCourse(Course):
    """The way from one slow minimum-jerk movement to all of the effort that may be used.

    The slowness is √(share at the goal / share), 1 at the goal, because durations go with it. That of the
    first movement is known once something has been learned.
    """

    def __init__(self, practice: PracticeConfig) -> None:
        self._first_s, self._share = practice.first_duration_s, practice.effort_share
        super().__init__([Leg("speed", self._first_s, self._first_s)], Movement(self._first_s))
        self._first_slowness = _FIRST_GUESS
        self._goal_slowness = 1.0
        self.possible_s: float | None = None
        """Duration at the goal, as far as is known."""

    def believe(self, possible_s: float) -> None:
        """Take in how long the goal takes by what has been learned now."""
        if self.possible_s is None:
            self._first_slowness = max(self._first_s / (_SLOWER_THAN_OPTIMAL * possible_s), _LEAST_FIRST)
        self.possible_s = possible_s

    @property
    def first_slowness(self) -> float:
        """Slowness of the first movement."""
        return self._first_slowness

    @property
    def goal_slowness(self) -> float:
        """Slowness of the goal: 1, unless it had to be made easier."""
        return self._goal_slowness

    def ease(self, slowness: float) -> None:
        """Make a slower movement the goal."""
        self._goal_slowness = slowness

    @property
    def is_eased(self) -> bool:
        """Whether the goal had to be made easier."""
        return self._goal_slowness > 1.0

    def movement(self, slowness: float) -> Movement:
        """Return the movement at a slowness."""
        if slowness >= self._first_slowness:
            return Movement(self._first_s * slowness / self._first_slowness)
        possible_s = self.possible_s or self._first_s / (_SLOWER_THAN_OPTIMAL * _FIRST_GUESS)
        return Movement(possible_s * slowness, effort_share=self._share / slowness**2)

    def alpha(self, movement: Movement) -> float:
        """Return the speed as a share of the goal's; 0 for the slow movement, when the goal is not known."""
        return 0.0 if movement.effort_share is None else (movement.effort_share / self._share) ** 0.5

    def varies_speed_at(self, slowness: float) -> bool:
        """Return that efforts are bounded by the movement itself."""
        return False

    def text(self, movement: Movement, duration: str = "") -> str:
        """Say what a movement is."""
        words = [duration or f"{movement.duration_s:.3f} s"]
        if movement.effort_share is not None:
            words.append(f"{100 * movement.effort_share:.0f} % of the effort limits")
        return ", ".join(words)

    @property
    def goal_text(self) -> str:
        """What the goal is."""
        about = "the fastest" if self.possible_s is None else f"{self.possible_s:.2f} s, the fastest"
        return f"{about} with {100 * self._share / self._goal_slowness**2:.3g} % of the effort limits"

    @property
    def ends(self) -> list[Movement]:
        """The first movement: all others keep the velocity limits by themselves."""
        return [Movement(self._first_s)]

    to_cover = ends


class Fastest(AdaptiveExtension):
    """Raises the share of the effort limits that movements may use, step by step.

    The first trial is slow and of minimum jerk. From what it shows the timing of the next one is made, which
    uses little effort, and so on: the steps are those of :class:`~.adaptive.AdaptiveExtension`. What it
    believes possible is said with each trial.

    If the error of the fastest movement stays above the tolerance, a little time is traded for accuracy: the
    movement becomes slower by as much as the error asks for.
    """

    _course: EffortCourse

    def __init__(self, config: Config) -> None:
        super().__init__(config, EffortCourse(config.practice))
        self._joints = config.arm.joints
        self._stiffness = np.array(config.arm.stiffness_nm_per_rad)
        self._effort_limit_nm = np.array(config.arm.effort_limit_nm)
        self._velocity_limit_rad_s = np.array(config.arm.velocity_limit_rad_s)
        self._standstills = 0
        self._error_at_goal: float | None = None
        """Of the last trial at the goal; None if that was another one."""

    def next(self, last: TrialReport | None, forecast: Forecaster) -> PlannedTrial | Ending:
        """Return the next trial, or the end of practice and its reason."""
        try:
            if last is not None and last.outcome == Outcome.COMPLETED:
                self._believe(forecast)
            decision = super().next(last, forecast)
            if isinstance(decision, Ending) and decision.outcome == "completed":
                words = [decision.message, self._limits(forecast(self._course.goal))]
                if self._course.is_eased:
                    words.append(
                        f"faster ones did not come within {1e3 * self._practice.tolerance_rad:g} mrad"
                    )
                return replace(decision, message="; ".join(words))
            return decision
        except TrajectoryError as error:
            return Ending("stopped", f"{self._course.goal_text} cannot be found: {error}")

    def _believe(self, forecast: Forecaster) -> None:
        was_known = self._course.possible_s is not None
        self._course.believe(forecast(self._course.goal).duration_s)
        if not was_known:
            self._slowness = self._safe_slowness = self._course.first_slowness

    def _is_easy(self, forecast: Forecast) -> bool:
        """Return whether also the effort should stay within its limits, with two standard deviations."""
        std_nm = self._ratio * self._stiffness * np.sqrt(np.mean(forecast.std_rad**2, axis=0))
        peak_nm = np.abs(forecast.effort_nm).max(axis=0)
        return super()._is_easy(forecast) and bool(np.all(peak_nm + 2.0 * std_nm <= self._effort_limit_nm))

    def _extended(self, hardest: float, forecast: Forecaster) -> PlannedTrial | Ending:
        before = self._slowness
        decision = super()._extended(hardest, forecast)
        hardly_faster = before <= self._slowness * _HARDLY_FASTER and self._slowness > hardest
        self._standstills = self._standstills + 1 if hardly_faster else 0
        if self._standstills < _STANDSTILLS:
            return decision
        assert isinstance(decision, PlannedTrial)
        return Ending(
            "stopped",
            f"{self._course.goal_text} is out of reach: what has been learned leaves too little certainty "
            f"for more than {self._course.text(decision.movement)}",
        )

    def _repeated(self, last: TrialReport, forecast: Forecaster) -> PlannedTrial | Ending:
        error_rad, before = last.rms_error_rad, self._error_at_goal
        at_goal = self._slowness <= self._course.goal_slowness
        self._error_at_goal = error_rad if at_goal else None
        has_stayed = before is not None and _HARDLY_BETTER * before <= error_rad <= ANOTHER_ARM * before
        if not (at_goal and has_stayed):
            return super()._repeated(last, forecast)
        factor = (error_rad / self._practice.tolerance_rad) ** (1.0 / _ERROR_EXPONENT)
        slowness = self._slowness * float(np.clip(factor, *_EASED))
        self._course.ease(slowness)
        self._course.believe(forecast(self._course.goal).duration_s)
        self._error_at_goal = None
        self._begin_movement()
        reason = f"slower for accuracy: {1e3 * error_rad:.2f} mrad RMS did not fall by repeating"
        return self._planned(slowness, forecast, reason)

    def _planned(
        self, slowness: float, forecast: Forecaster, reason: str, go_back_to: int | None = None
    ) -> PlannedTrial:
        plan = super()._planned(slowness, forecast, reason, go_back_to)
        possible_s = self._course.possible_s
        if possible_s is not None:
            share = self._practice.effort_share
            share /= self._course.goal_slowness**2
            possible = f"about {possible_s:.2f} s are possible at {100 * share:.3g} % of the effort limits"
            movement = replace(plan.movement, duration_s=forecast(plan.movement).duration_s)
            plan = replace(
                plan, movement=movement, reason=f"{plan.reason}; {possible}", possible_s=possible_s
            )
            self._plan = plan
        return plan

    def _limits(self, forecast: Forecast) -> str:
        """Say which joints limit a movement, for which shares of its time."""
        may_nm = (self._course.goal.effort_share or 1.0) * self._effort_limit_nm
        may_rad_s = VELOCITY_SHARE * self._velocity_limit_rad_s
        found = [
            (float(part), f"{what} of {joint}")
            for what, values, most in (
                ("effort", forecast.effort_nm, may_nm),
                ("velocity", forecast.velocity_rad_s, may_rad_s),
            )
            for part, joint in zip(
                np.mean(np.abs(values) >= AT_THE_LIMIT * most, axis=0), self._joints, strict=True
            )
            if part >= 0.01
        ]
        words = [f"{what} for {100 * part:.0f} % of the time" for part, what in sorted(found, reverse=True)]
        return f"limited by {', '.join(words)}" if words else "limited by the rate of the efforts"
