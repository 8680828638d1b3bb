"""Learning in service: how fast a trajectory may be run, and what becomes of the network afterwards."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Generic, Protocol, TypeVar

import numpy as np

from tel_ros.core.config import Config
from tel_ros.core.control.tracking import Limits
from tel_ros.core.errors import NetworkFileError, TelError, TrainingError, TrajectoryError
from tel_ros.core.learning.learner import TrainingOutcome, rms
from tel_ros.core.practice.adaptive import ANOTHER_ARM
from tel_ros.core.practice.session import CommandedTrial, PracticeArm, PracticeNetwork
from tel_ros.core.practice.strategy import Movement, PlannedTrial
from tel_ros.core.serving.memory import Remembered, ServiceMemory
from tel_ros.core.serving.reference import Points, Reference, RefusedError
from tel_ros.core.springs import Springs
from tel_ros.core.trial import Outcome, TrialGoal, TrialReport
from tel_ros.core.types import FloatArray

TrialT = TypeVar("TrialT")
_FORECAST_POINTS = 200
_BISECTIONS = 7
_SLOWER_AFTER_ABORT = math.sqrt(2.0)
_MOST_OPTIMISTIC = 0.3
_USABLE_SHARE = 0.97
"""Of an effort limit: the rest is for the springs, which correct what the network gets wrong."""
_SAME_SLOWDOWN = 1.05


class ServiceStore(Protocol):
    """Keeps what must survive."""

    def keep(self, memory: ServiceMemory) -> None:
        """Keep the memory, atomically, and of the networks the last ones; may raise a TelError."""
        ...

    def networks(self) -> list[int]:
        """Return after which executions networks are kept, in order."""
        ...


@dataclass(frozen=True)
class Decision:
    """How a trajectory is to be executed, and why."""

    key: str
    slowdown: float
    expected_rad: float
    """RMS error; inf: not known."""
    commanded: CommandedTrial
    said: str
    """About a speed that is not the requested one, for people; may be empty."""


@dataclass(frozen=True)
class Served(Generic[TrialT]):
    """An execution that has ended, however it did."""

    decision: Decision
    report: TrialReport
    trial: TrialT
    training: TrainingOutcome | None
    notes: tuple[str, ...]
    """What became of the network, where that is not as usual."""

    @property
    def text(self) -> str:
        """How it went, for the result."""
        error = f"error {_mrad(self.report.rms_error_rad)} RMS" if self.report.run_ns > 0 else ""
        return "; ".join(filter(None, (self.decision.said, error, *self.notes)))


class ServingSession(Generic[TrialT]):
    """Executes trajectories one after the other, and learns from each.

    The network in use is loaded anew before every execution: whatever else has happened to the process that
    holds it, what is commanded comes from what is kept.

    Args:
        config: of the service.
        arm: executes.
        network: predicts, learns, and knows its earlier states by the numbers of executions.
        store: keeps the memory.
        memory: what it was when the service ended the last time.
    """

    def __init__(
        self,
        config: Config,
        arm: PracticeArm[TrialT],
        network: PracticeNetwork[TrialT],
        store: ServiceStore,
        memory: ServiceMemory,
    ) -> None:
        self._config, self._arm, self._network, self._store = config, arm, network, store
        self.memory = memory
        self._limits = Limits.of(config.arm, config.control.path_tolerance_rad)
        self._springs = Springs.of(config.arm)
        self._effort_limit_nm = _USABLE_SHARE * np.array(config.arm.effort_limit_nm)

    def reference(self, points: Points, here_rad: FloatArray) -> Reference:
        """Return the movement that is asked for; ``here_rad``: where the arm is, shape (n_joints,).

        Raises:
            RefusedError: the arm must not follow it at the requested speed, or is not at its first point.
        """
        serve, arm = self._config.serve, self._config.arm
        if points.time_ns[0] == 0:
            off = np.abs(points.position_rad[0] - here_rad)
            j = int(np.argmax(off))
            if not off[j] <= serve.start_tolerance_rad:
                raise RefusedError(
                    f"the first point is away from where the arm is: {arm.joints[j]} is at {here_rad[j]:.3f} "
                    f"rad, and the trajectory begins at {points.position_rad[0, j]:.3f} rad "
                    f"(serve.start_tolerance_rad is {serve.start_tolerance_rad:g})"
                )
        reference = Reference(points, here_rad)
        desired = reference.desired(1.0, self._config.control.rate_hz)
        goal = TrialGoal(1, 1.0, desired, desired.position_rad)
        try:
            self._limits.check_goal(goal, self._config.control.settle_speed_rad_s)
        except TrajectoryError as error:
            raise RefusedError(str(error)) from None
        return reference

    def decide(self, points: Points, here_rad: FloatArray) -> Decision:
        """Decide how fast a trajectory is run, with the network as it is.

        Raises:
            RefusedError: it is not executed.
        """
        reference = self.reference(points, here_rad)
        broken = self._load()
        serve, known = self._config.serve, self.memory.movements.get(points.key)
        least = known.least_slowdown if known else 1.0
        expected_rad, lacking = self._expected(reference, 1.0)
        if known and known.slowdown == 1.0:
            expected_rad = min(expected_rad, known.error_rad)  # has been seen
        is_sure = expected_rad <= serve.tolerance_rad
        if is_sure and lacking:
            raise RefusedError(f"too fast: {lacking}")
        slowdown, said = 1.0, ""
        if not is_sure or least > 1.0:
            why = f"{_mrad(expected_rad)} were expected at the requested speed"
            if math.isinf(expected_rad):
                why = "nothing has been learned for the requested speed"
            if is_sure:
                why = "it was aborted when it was faster"
            if not serve.may_slow_down:
                raise RefusedError(
                    f"{why}, serve.tolerance_rad is {serve.tolerance_rad:g}, and serve.may_slow_down is false"
                )
            slowdown = max(least, self._sure_slowdown(reference, expected_rad))
            expected_rad, lacking = self._expected(reference, slowdown)
            said = f"{slowdown:.2f} times slower than requested: {why}"
        index = self.memory.executions + 1
        commanded = self._commanded(reference, slowdown, index, expected_rad)
        return Decision(
            points.key, slowdown, expected_rad, commanded, "; ".join(filter(None, (broken, said)))
        )

    def execute(self, decision: Decision) -> Served[TrialT]:
        """Execute, learn, and keep what was learned.

        What cannot be learned or kept is told in the notes: the movement has been made.
        """
        self.memory = replace(self.memory, executions=decision.commanded.plan.index)
        report, trial = self._arm.execute(decision.commanded)
        notes: list[str] = []
        training = None
        try:
            if report.outcome == Outcome.COMPLETED:
                training = self._completed(decision, report, trial, notes)
            else:
                notes.append("nothing was learned")
                if report.outcome == Outcome.ABORTED and report.run_ns > 0:
                    self._aborted(decision, notes)
            self._store.keep(self.memory)
        except TelError as error:
            notes.append(f"what was learned is not kept: {error}")
        return Served(decision, report, trial, training, tuple(notes))

    def _load(self) -> str:
        """Load the network in use; where its file is broken, the newest one that is whole. Say so then."""
        kept = [
            self.memory.network,
            *(k for k in reversed(self._store.networks()) if k != self.memory.network),
        ]
        problem: TelError | None = None
        for index in kept:
            try:
                self._network.load(index)
            except (NetworkFileError, TrainingError) as error:
                problem = problem or error
                continue
            self.memory = replace(self.memory, network=index)
            return f"{problem}; the network after execution {index} is used" if problem else ""
        raise RefusedError(f"no network can be loaded: {problem}")

    def _expected(self, reference: Reference, slowdown: float) -> tuple[float, str]:
        """Return the RMS error to expect, and which joint would need more effort than it has, if any."""
        rate_hz = _FORECAST_POINTS / (reference.duration_s * slowdown)
        desired = reference.desired(slowdown, rate_hz)
        prediction = self._network.predict(desired)
        expected_rad = self.memory.ratio * rms(prediction.std_rad)
        effort = self._springs.effort(
            prediction.equilibrium_rad, desired.position_rad, desired.velocity_rad_s
        )
        needed = np.abs(effort).max(axis=0)
        j = int(np.argmax(needed / self._effort_limit_nm))
        lacking = ""
        if needed[j] > self._effort_limit_nm[j]:
            limit_nm = self._config.arm.effort_limit_nm[j]
            lacking = f"{self._config.arm.joints[j]} would need {needed[j]:.1f} of {limit_nm:g} N·m"
        return expected_rad, lacking

    def _sure_slowdown(self, reference: Reference, expected_rad: float) -> float:
        """Return the least slowdown at which the error should stay within the tolerance, up to the largest.

        ``expected_rad``: of the requested speed. What the learner cannot tell apart from noise looks equally
        uncertain at any speed, while the errors of a rigid arm go with its torques, with 1/T²: the less of
        the two answers counts.
        """
        tolerance_rad, most = self._config.serve.tolerance_rad, self._config.serve.most_slowdown
        if math.isinf(expected_rad):
            return most
        by_torque = min(most, math.sqrt(expected_rad / tolerance_rad))
        by_error = self._least(most, lambda slowdown: self._expected(reference, slowdown)[0] <= tolerance_rad)
        by_effort = self._least(most, lambda slowdown: not self._expected(reference, slowdown)[1])
        return max(min(by_torque, by_error), by_effort)

    def _least(self, most: float, is_good: Callable[[float], bool]) -> float:
        """Return the least slowdown that is good; ``most`` if none is: somewhere it has to learn."""
        low, high = 1.0, most
        if is_good(low):
            return low
        if not is_good(high):
            return high
        for _ in range(_BISECTIONS):
            middle = math.sqrt(low * high)
            low, high = (low, middle) if is_good(middle) else (middle, high)
        return high

    def _commanded(
        self, reference: Reference, slowdown: float, index: int, expected_rad: float
    ) -> CommandedTrial:
        desired = reference.desired(slowdown, self._config.control.rate_hz)
        prediction = self._network.predict(desired)
        plan = PlannedTrial(
            index,
            1.0 / slowdown,
            Movement(desired.duration_s),
            reason="in service",
            expected_rms_rad=expected_rad if math.isfinite(expected_rad) else math.nan,
        )
        goal = TrialGoal(index, plan.alpha, desired, prediction.equilibrium_rad)
        return CommandedTrial(plan, goal, prediction.std_rad, prediction.revision)

    def _completed(
        self, decision: Decision, report: TrialReport, trial: TrialT, notes: list[str]
    ) -> TrainingOutcome | None:
        memory, error_rad = self.memory, report.rms_error_rad
        known = memory.movements.get(decision.key)
        is_worse = self._is_worse(known, decision, error_rad)
        if is_worse and self._take_back(known, notes):
            return None
        expected_std = decision.expected_rad / memory.ratio
        if math.isfinite(expected_std) and expected_std > 0.0:
            found = error_rad / expected_std
            # Bad news count at once, good news by and by.
            ratio = max(found, math.sqrt(found * memory.ratio), _MOST_OPTIMISTIC)
            self.memory = replace(memory, ratio=ratio)
        least = math.sqrt(known.least_slowdown) if known else 1.0  # by and by what it was before an abort
        best = Remembered(error_rad, decision.slowdown, memory.network)
        is_faster = known is None or decision.slowdown < known.slowdown / _SAME_SLOWDOWN
        # Worse with the network of before as well: the arm has changed, and this is what counts from now on.
        if known is not None and not (is_faster or is_worse or error_rad <= known.error_rad):
            best = known
        self.memory = self.memory.remembering(
            decision.key, replace(best, least_slowdown=least if least > _SAME_SLOWDOWN else 1.0)
        )
        try:
            training = self._network.train(trial)
        except TrainingError as error:
            notes.append(f"nothing was learned: {error}")
            return None
        index = report.index
        try:
            self._network.save(index)
        except TelError:
            self._load()  # what is not kept is not used either
            raise
        self.memory = replace(self.memory, network=index)
        return training

    def _is_worse(self, known: Remembered | None, decision: Decision, error_rad: float) -> bool:
        """Return whether a movement came out clearly worse than before, although it was no faster."""
        return (
            known is not None
            and error_rad > max(ANOTHER_ARM * known.error_rad, self._config.serve.tolerance_rad)
            and decision.slowdown >= known.slowdown / _SAME_SLOWDOWN
        )

    def _take_back(self, known: Remembered | None, notes: list[str]) -> bool:
        """Go back to the network with which a movement was good; return whether there is another one."""
        if known is None:
            return False
        kept = [k for k in self._store.networks() if k < self.memory.network]
        earlier = [k for k in kept if k <= known.network] or kept
        if not kept or known.network == self.memory.network:
            return False
        back = earlier[-1] if earlier[-1] <= known.network else earlier[0]
        self.memory = replace(self.memory, network=back)
        notes.append(
            f"clearly worse than the {_mrad(known.error_rad)} of before: the network of before is taken back"
        )
        return True

    def _aborted(self, decision: Decision, notes: list[str]) -> None:
        known = self.memory.movements.get(decision.key)
        slower = min(decision.slowdown * _SLOWER_AFTER_ABORT, self._config.serve.most_slowdown)
        if known is not None and decision.slowdown >= known.slowdown / _SAME_SLOWDOWN:
            self._take_back(known, notes)
        unknown = Remembered(self._limits.path_tolerance_rad, slower, self.memory.network)
        best = known or unknown
        self.memory = self.memory.remembering(decision.key, replace(best, least_slowdown=slower))


def _mrad(error_rad: float) -> str:
    return f"{1e3 * error_rad:.2f} mrad"
