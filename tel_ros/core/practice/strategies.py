"""Practice strategies by name: ours, and those that other packages offer.

An entry point of the group ``tel_ros.strategies`` names a function or class that takes the configuration and
returns a :class:`~.strategy.Strategy`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from tel_ros.core.config import Config, PracticeConfig
from tel_ros.core.errors import ConfigError, counted
from tel_ros.core.plugins import plugin
from tel_ros.core.practice.adaptive import AdaptiveExtension
from tel_ros.core.practice.course import Course, Leg
from tel_ros.core.practice.fastest import Fastest
from tel_ros.core.practice.library import Library
from tel_ros.core.practice.strategy import Ending, Forecaster, Movement, PlannedTrial, Strategy
from tel_ros.core.trial import Outcome, TrialReport
from tel_ros.core.types import FloatArray


class FixedSchedule:
    """Trial after trial of a list, whatever comes out; the course gives α and the movements to cover."""

    def __init__(
        self,
        movements: Sequence[Movement],
        course: Course,
        practice: PracticeConfig,
        fastest: Sequence[Movement],
    ) -> None:
        self._movements, self._course, self._fastest = movements, course, fastest
        self._stop_on_abort = practice.on_abort == "stop"
        self._done = 0

    def preview(self) -> Sequence[Movement]:
        """Return the movements still to come."""
        return self._movements[self._done :]

    def movements_to_cover(self) -> Sequence[Movement]:
        """Return the movements that bound the course."""
        return self._course.to_cover

    def fastest_movements(self) -> Sequence[Movement]:
        """Return the fastest movements of the schedule."""
        return self._fastest

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


def trajectory_extension(config: Config) -> FixedSchedule:
    """Go step by step from the first movement to the goal ([Practice] Sec. 2.2 and 3).

    The speed goes up in even steps of duration T as in the paper, of speed 1/T, or of the torque that the
    movement needs, 1/T²; or through a list of durations. Whatever else varies goes in even steps of its
    logarithm, the shape in even steps (see :class:`~.course.Leg`). The trials are spread evenly over all that
    varies.
    """
    practice, course = config.practice, Course.configured(config.practice)
    if practice.vary != ("speed",) and practice.trials <= len(practice.vary):
        expected = f"more than the {len(practice.vary)} things that vary"
        raise ConfigError("practice.trials", practice.trials, expected)
    if practice.durations_s:
        movements = [course.at_duration(duration_s) for duration_s in practice.durations_s]
        return FixedSchedule(movements, course, practice, [course.at_duration(min(practice.durations_s))])
    movements = []
    shares = np.array_split(np.arange(practice.trials), len(course.legs))
    for leg, trials in zip(course.legs, shares, strict=True):
        # Where a leg begins is where the one before it has ended.
        values = _even_steps(leg, len(trials) + bool(movements), practice.spacing)[bool(movements) :]
        movements += [course.on_leg(leg, float(value)) for value in values]
    return FixedSchedule(movements, course, practice, course.ends)


def direct(config: Config) -> FixedSchedule:
    """Practise the goal from the start: the control condition of [Practice] Sec. 3."""
    practice, course = config.practice, Course.configured(config.practice)
    goals = [Movement(practice.goal_duration_s)] * practice.trials
    return FixedSchedule(goals, course, practice, [course.goal])


def _even_steps(leg: Leg, n: int, spacing: str) -> FloatArray:
    """Return values of what varies on a leg from its first to its goal. Shape (n,)."""
    if leg.varied == "speed":
        power = {"duration": 1.0, "speed": -1.0, "torque": -2.0}[spacing]
        steps = np.linspace(leg.first**power, leg.goal**power, n)
        values: FloatArray = steps ** (1.0 / power)
    else:
        first, goal = leg.slowness(leg.first), leg.slowness(leg.goal)
        slownesses = np.exp(np.linspace(np.log(first), np.log(goal), n))
        values = np.array([leg.value(float(slowness)) for slowness in slownesses])
    values[-1] = leg.goal  # free of rounding: the last movement of a leg is the one that was asked for
    return values


class Subtasks:
    """The three-step strategy: practise pieces of the goal before the whole ([Practice] Sec. 1.2).

    First the whole path at the first duration, which equilibrium-point control almost does by itself; then
    each part, from the first duration up to the goal's; then the whole at the goal speed. The steps within
    each are those of :class:`~.adaptive.AdaptiveExtension`. All but the last are practised to the tolerance
    of a step, the last to that of the goal.

    A part starts and stops at rest, so it takes more effort than within the whole. If a part cannot be
    learned, practice ends.
    """

    def __init__(self, config: Config) -> None:
        self._config, practice = config, config.practice
        if practice.vary != ("speed",):
            expected = "only speed, because strategy is 'subtasks'"
            raise ConfigError("practice.vary", list(practice.vary), expected)
        first_s, goal_s, n = practice.first_duration_s, practice.goal_duration_s, practice.parts
        self._whole = Course.configured(practice)
        self._parts = [Movement(goal_s, start=k / n, end=(k + 1) / n) for k in range(n)]
        slow = Course([Leg("speed", first_s, first_s)], Movement(goal_s))
        parts = [Course(self._whole.legs, part) for part in self._parts]
        self._stages = [
            ("the whole, slowly", slow, first_s),
            *((f"part {k} of {n}", part, first_s) for k, part in enumerate(parts, start=1)),
            ("the whole", self._whole, goal_s),
        ]
        """Name for people, course and first slowness of the tasks that are practised one after the other."""
        self._current = 0
        self._strategy = self._begin(0, first_index=1)

    def preview(self) -> Sequence[Movement]:
        """Return the movements still to come, as far as the strategy knows now."""
        movements = list(self._strategy.preview())
        for stage in range(self._current + 1, len(self._stages)):
            movements += self._begin(stage, first_index=1).preview()
        return movements[: self._strategy.trials_left]

    def next(self, last: TrialReport | None, forecast: Forecaster) -> PlannedTrial | Ending:
        """Return the next trial, or the end of practice and its reason."""
        decision = self._strategy.next(last, forecast)
        while isinstance(decision, Ending) and decision.outcome == "completed" and last is not None:
            if self._current + 1 == len(self._stages):
                return decision
            trials = self._config.practice.trials
            if last.index >= trials:
                done = f"{counted(trials, 'trial')} used up after {self._stages[self._current][0]}"
                return Ending("stopped", f"{done}: {decision.message}")
            self._current += 1
            self._strategy = self._begin(self._current, first_index=last.index + 1)
            decision = self._strategy.next(None, forecast)
        name = self._stages[self._current][0]
        if isinstance(decision, Ending):
            return replace(decision, message=f"{name}: {decision.message}")
        return replace(decision, reason=f"{name}: {decision.reason}")

    def movements_to_cover(self) -> Sequence[Movement]:
        """Return the whole and its parts, which accelerate more at their ends."""
        return [*self._whole.to_cover, *self._parts]

    def fastest_movements(self) -> Sequence[Movement]:
        """Return the ends of the course of the whole, and the parts."""
        return [*self._whole.ends, *self._parts]

    def _begin(self, stage: int, first_index: int) -> AdaptiveExtension:
        _, course, first_slowness = self._stages[stage]
        config, practice = self._config, self._config.practice
        if stage + 1 < len(self._stages):
            practice = replace(practice, tolerance_rad=practice.step_tolerance_rad)
            config = replace(config, practice=practice)
        return AdaptiveExtension(config, course, first_index, first_slowness)


def adaptive_extension(config: Config) -> AdaptiveExtension:
    """Choose each step anew, on the way to a duration or to what the effort limits allow."""
    return Fastest(config) if config.practice.is_fastest else AdaptiveExtension(config)


GROUP = "tel_ros.strategies"
OURS: dict[str, Callable[[Config], Strategy]] = {
    "trajectory_extension": trajectory_extension,
    "adaptive_extension": adaptive_extension,
    "subtasks": Subtasks,
    "direct": direct,
}


def make_strategy(config: Config) -> Strategy:
    """Return a new strategy of the configured name; for several paths one for each (:class:`.Library`).

    Raises:
        ConfigError: the name is not known, what an entry point names cannot be used, or the strategy cannot
            do what is configured.
    """
    name = config.practice.strategy
    if config.practice.is_fastest and name in OURS and name != "adaptive_extension":
        expected = "adaptive_extension, because goal is 'fastest'"
        raise ConfigError("practice.strategy", name, expected)
    methods = ("preview", "next", "movements_to_cover", "fastest_movements")

    def made(config: Config) -> Strategy:
        return plugin("practice.strategy", name, GROUP, OURS, methods, lambda make: make(config))

    return Library(config, made) if config.path.files else made(config)
