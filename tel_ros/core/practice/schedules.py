"""Fixed schedules of movements, and practice of the parts before the whole."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tel_ros.core.config import ArmConfig, PracticeConfig
from tel_ros.core.practice.adaptive import AdaptiveExtension
from tel_ros.core.practice.course import Course, Leg
from tel_ros.core.practice.strategy import Ending, Forecaster, Movement, PlannedTrial
from tel_ros.core.trial import Outcome, TrialReport
from tel_ros.core.types import FloatArray


class FixedSchedule:
    """Trial after trial of a list, whatever comes out.

    Args:
        movements: of the trials, in order.
        course: gives α and the movements to cover.
        stop_on_abort: whether an aborted trial ends the run.
        fastest: see :meth:`~.strategy.Strategy.fastest_movements`.
    """

    def __init__(
        self, movements: Sequence[Movement], course: Course, stop_on_abort: bool, fastest: Sequence[Movement]
    ) -> None:
        self._movements, self._course, self._fastest = list(movements), course, fastest
        self._stop_on_abort = stop_on_abort
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
        return FixedSchedule(movements, course, stop_on_abort, [course.at_duration(min(config.durations_s))])
    movements = []
    shares = np.array_split(np.arange(config.trials), len(course.legs))
    for leg, trials in zip(course.legs, shares, strict=True):
        # Where a leg begins is where the one before it has ended.
        n_points = len(trials) + bool(movements)
        movements += [
            course.on_leg(leg, float(value))
            for value in _even_steps(leg, n_points, config.spacing)[bool(movements) :]
        ]
    return FixedSchedule(movements, course, stop_on_abort, course.ends)


def direct(config: PracticeConfig) -> FixedSchedule:
    """Practise the goal from the start: the control condition of [Practice] Sec. 3."""
    goal, course = Movement(config.goal_duration_s), Course.configured(config)
    return FixedSchedule([goal] * config.trials, course, config.on_abort == "stop", [course.goal])


def _even_steps(leg: Leg, n: int, spacing: str) -> FloatArray:
    """Return values of what varies on a leg from its first to its goal. Shape (n,)."""
    if leg.varied == "speed":
        power = {"duration": 1.0, "speed": -1.0, "torque": -2.0}[spacing]
        steps = np.linspace(leg.first**power, leg.goal**power, n)
        values: FloatArray = steps ** (1.0 / power)
    else:
        slownesses = np.exp(np.linspace(np.log(leg.first_slowness), np.log(leg.goal_slowness), n))
        values = np.array([leg.value(float(slowness)) for slowness in slownesses])
    values[-1] = leg.goal  # free of rounding: the last movement of a leg is the one that was asked for
    return values


@dataclass(frozen=True)
class _Stage:
    """One of the tasks that are practised one after the other.

    Args:
        name: for people.
        course: from where to where.
        first_slowness: where on the course to begin.
        tolerance_rad: RMS error at its end at which it is over.
    """

    name: str
    course: Course
    first_slowness: float
    tolerance_rad: float


class Subtasks:
    """The three-step strategy: practise pieces of the goal before the whole ([Practice] Sec. 1.2).

    First the whole path at the first duration, which equilibrium-point control almost does by itself; then
    each part, from the first duration up to the goal's; then the whole at the goal speed. The steps within
    each are those of :class:`~.adaptive.AdaptiveExtension`. All but the last are practised to the tolerance
    of a step, the last to that of the goal.

    A part starts and stops at rest, so it takes more effort than within the whole. If a part cannot be
    learned, practice ends.

    Args:
        practice: durations, tolerances, number of parts, most trials of all together.
        arm: effort limits.
        path_tolerance_rad: deviation at which a trial is aborted.
    """

    def __init__(self, practice: PracticeConfig, arm: ArmConfig, path_tolerance_rad: float) -> None:
        self._practice, self._arm, self._path_tolerance_rad = practice, arm, path_tolerance_rad
        self._stages = _stages(practice)
        self._current = 0
        self._stage = self._strategy(self._stages[0], first_index=1)

    def preview(self) -> Sequence[Movement]:
        """Return the movements still to come, as far as the strategy knows now."""
        movements = list(self._stage.preview())
        for stage in self._stages[self._current + 1 :]:
            movements += self._strategy(stage, first_index=1).preview()
        return movements[: self._stage.trials_left]

    def next(self, last: TrialReport | None, forecast: Forecaster) -> PlannedTrial | Ending:
        """Return the next trial, or the end of practice and its reason."""
        decision = self._stage.next(last, forecast)
        while isinstance(decision, Ending) and decision.outcome == "completed" and last is not None:
            if self._current + 1 == len(self._stages):
                return decision
            if last.index >= self._practice.trials:
                return Ending(
                    "stopped",
                    f"{self._practice.trials} trials are over after {self._name}: {decision.message}",
                )
            self._current += 1
            self._stage = self._strategy(self._stages[self._current], first_index=last.index + 1)
            decision = self._stage.next(None, forecast)
        if isinstance(decision, Ending):
            return Ending(decision.outcome, f"{self._name}: {decision.message}")
        return replace(decision, reason=f"{self._name}: {decision.reason}")

    def movements_to_cover(self) -> Sequence[Movement]:
        """Return the whole and its parts, which accelerate more at their ends."""
        return [*Course.configured(self._practice).to_cover, *_parts(self._practice)]

    def fastest_movements(self) -> Sequence[Movement]:
        """Return the ends of the course of the whole, and the parts."""
        return [*Course.configured(self._practice).ends, *_parts(self._practice)]

    def _strategy(self, stage: _Stage, first_index: int) -> AdaptiveExtension:
        return AdaptiveExtension(
            replace(self._practice, tolerance_rad=stage.tolerance_rad),
            self._arm,
            self._path_tolerance_rad,
            course=stage.course,
            first_index=first_index,
            first_slowness=stage.first_slowness,
        )

    @property
    def _name(self) -> str:
        return self._stages[self._current].name


def _parts(practice: PracticeConfig) -> list[Movement]:
    """Return the parts of the goal movement, at the goal's speed, in order."""
    n = practice.parts
    return [Movement(practice.goal_duration_s, start=k / n, end=(k + 1) / n) for k in range(n)]


def _stages(practice: PracticeConfig) -> list[_Stage]:
    first_s, goal_s, step_rad = (
        practice.first_duration_s,
        practice.goal_duration_s,
        practice.step_tolerance_rad,
    )
    faster = [Leg("speed", first_s, goal_s)]
    slow = Course([Leg("speed", first_s, first_s)], Movement(goal_s))
    stages = [_Stage("the whole, slowly", slow, first_s, step_rad)]
    for k, part in enumerate(_parts(practice), start=1):
        stages.append(_Stage(f"part {k} of {practice.parts}", Course(faster, part), first_s, step_rad))
    whole = Course(faster, Movement(goal_s))
    return [*stages, _Stage("the whole", whole, goal_s, practice.tolerance_rad)]
