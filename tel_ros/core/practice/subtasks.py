"""The three-step practice strategy: a known movement, then the parts of the goal, then the whole."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from tel_ros.core.config import ArmConfig, PracticeConfig
from tel_ros.core.practice.adaptive import AdaptiveExtension
from tel_ros.core.practice.course import Course, Leg
from tel_ros.core.practice.decisions import Ending, Forecaster, Movement, PlannedTrial
from tel_ros.core.trial import TrialReport


@dataclass(frozen=True)
class _Stage:
    """One of the tasks that are practised one after the other.

    Args:
        name: for people.
        course: from where to where.
        first_ease: where on the course to begin.
        tolerance_rad: RMS error at its end at which it is over.
    """

    name: str
    course: Course
    first_ease: float
    tolerance_rad: float


class Subtasks:
    """Practises pieces of the goal one by one before the whole ([Practice] Sec. 1.2).

    First the whole path at the first duration, which equilibrium-point control can almost do by itself; then
    each of its parts, from the first duration up to the goal's; then the whole at the goal speed. The steps
    within each are those of :class:`~.adaptive.AdaptiveExtension`. What comes before the last is practised
    until its error is within the tolerance of a step, the last until it is within that of the goal.

    A part starts and stops at rest, with a time scaling of its own, so it takes more effort than within the
    whole. If it cannot be learned because of that or for any other reason, practice ends: the whole would
    have to do without it.

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
        """Return the movements that are still to come, this far as it looks now."""
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

    def _strategy(self, stage: _Stage, first_index: int) -> AdaptiveExtension:
        return AdaptiveExtension(
            replace(self._practice, tolerance_rad=stage.tolerance_rad),
            self._arm,
            self._path_tolerance_rad,
            course=stage.course,
            first_index=first_index,
            first_ease=stage.first_ease,
        )

    @property
    def _name(self) -> str:
        return self._stages[self._current].name


def parts_of(practice: PracticeConfig) -> list[Movement]:
    """Return the parts of the goal movement, as fast as the goal is, in order."""
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
    for k, part in enumerate(parts_of(practice), start=1):
        stages.append(_Stage(f"part {k} of {practice.parts}", Course(faster, part), first_s, step_rad))
    whole = Course(faster, Movement(goal_s))
    return [*stages, _Stage("the whole", whole, goal_s, practice.tolerance_rad)]
