"""An arm that is nothing but a formula for errors: strategies can be tried on it in no time."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from two_link import arm_config

from tel_ros.core.config import Config, ControlConfig, PathConfig, PracticeConfig
from tel_ros.core.practice.strategy import Ending, Forecast, Movement, PlannedTrial, Strategy
from tel_ros.core.trial import Outcome, TrialReport
from tel_ros.core.types import FloatArray


def config_of(path_tolerance_rad: float = 1.0, **practice: object) -> Config:
    """Return a configuration with these values in its section ``practice``."""
    settings = PracticeConfig(**practice)  # type: ignore[arg-type]
    return Config(
        arm=arm_config(),
        path=PathConfig(name="planar_loops", known_name="planar_loops" if "shape" in settings.vary else ""),
        practice=settings,
        control=ControlConfig(path_tolerance_rad=path_tolerance_rad),
    )


def report_of(
    plan: PlannedTrial,
    outcome: Outcome = Outcome.COMPLETED,
    rms_error_rad: float = 0.01,
    max_error_rad: float = 0.03,
) -> TrialReport:
    """Return what the controller would report of a trial."""
    return TrialReport(
        index=plan.index,
        alpha=plan.alpha,
        duration_s=plan.movement.own_duration_s,
        outcome=outcome,
        message="elbow is off" if outcome == Outcome.ABORTED else "",
        start_ns=0,
        run_ns=1,
        end_ns=2,
        ticks=3,
        rms_error_rad=rms_error_rad,
        rms_error_per_joint_rad=np.full(2, rms_error_rad),
        max_error_rad=max_error_rad,
        max_effort_nm=np.zeros(2),
        saturated_ratio=0.0,
    )


@dataclass
class MadeUpArm:
    """Errors grow with the distance, in the logarithm of the duration, from what has been learned.

    Args:
        growth_rad: error of a learner at a speed that is e times as high as the nearest one that it knows.
        floor_rad: error at speeds that it knows.
        unlearned_rad: error of the first trial at 10 s; it goes with 1/T².
        frankness: the learner's standard deviation in proportion to the error that will come.
        peak_nms2: effort of the first joint times T².
        static_nm: effort that does not depend on the speed.
        abort_rad: an error above this aborts the trial.
        deaf: the learner learns nothing: errors stay.
    """

    growth_rad: float = 0.05
    floor_rad: float = 1e-3
    unlearned_rad: float = 0.07
    frankness: float = 1.0
    peak_nms2: float = 150.0
    static_nm: float = 0.0
    abort_rad: float = 0.3
    deaf: bool = False
    _known_s: list[float] = field(default_factory=list)
    _known_after: dict[int, list[float]] = field(default_factory=lambda: {0: []})

    def error_rad(self, duration_s: float) -> float:
        """Return the RMS error that a movement would have now."""
        if not self._known_s:
            return self.unlearned_rad * (10.0 / duration_s) ** 2
        distance = min(abs(math.log(known_s / duration_s)) for known_s in self._known_s)
        return self.floor_rad + self.growth_rad * distance

    def forecast(self, movement: Movement) -> Forecast:
        """Return what a learner on this arm would expect."""
        duration_s = movement.duration_s
        std = self.frankness * self.error_rad(duration_s) if self._known_s else math.inf
        effort: FloatArray = np.zeros((50, 2))
        effort[:, 0] = self.static_nm + np.sin(np.linspace(0.0, 6.28, 50)) * self.peak_nms2 / duration_s**2
        return Forecast(np.full((50, 2), std), effort, np.zeros((50, 2)), duration_s)

    def execute(self, plan: PlannedTrial) -> TrialReport:
        """Return how a trial goes, and learn from it."""
        if plan.go_back_to is not None:
            self._known_s = list(self._known_after[plan.go_back_to])
        error_rad = self.error_rad(plan.movement.duration_s)
        aborted = error_rad > self.abort_rad
        if not aborted and not self.deaf:
            self._known_s.append(plan.movement.duration_s)
        elif not self._known_s:
            self._known_s = []
        self._known_after[plan.index] = list(self._known_s)
        return report_of(plan, Outcome.ABORTED if aborted else Outcome.COMPLETED, error_rad, 3.0 * error_rad)


def practise(
    strategy: Strategy, arm: MadeUpArm, changes: dict[int, MadeUpArm] | None = None
) -> tuple[list[PlannedTrial], list[TrialReport], Ending]:
    """Run a strategy to its end.

    Args:
        strategy: what is tried.
        arm: what it is tried on.
        changes: by index of the trial before which it happens, the arm that it becomes; what was learned of
            the old one is then no better than nothing.
    """
    plans: list[PlannedTrial] = []
    reports: list[TrialReport] = []
    last: TrialReport | None = None
    while True:
        decision = strategy.next(last, arm.forecast)
        if isinstance(decision, Ending):
            return plans, reports, decision
        plans.append(decision)
        assert len(plans) <= 100, "practice does not end"
        if changes and decision.index in changes:
            arm = changes[decision.index]
            arm._known_after = {index: [] for index in range(decision.index)}
        last = arm.execute(decision)
        reports.append(last)
