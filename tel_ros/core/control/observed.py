"""The course of a trial whose springs are in another controller."""

from __future__ import annotations

from collections import deque

import numpy as np

from tel_ros.core.arm_state import ArmState
from tel_ros.core.config import ArmConfig, ControlConfig, SafetyConfig
from tel_ros.core.control.controller import EpController
from tel_ros.core.control.tracking import Target, TrialCourse
from tel_ros.core.control.trajectory_points import TrajectoryPoints
from tel_ros.core.errors import TrajectoryError
from tel_ros.core.safety.rules import EffortRate, Permitted
from tel_ros.core.springs import Springs
from tel_ros.core.trial import Phase, TrialGoal
from tel_ros.core.types import NS_PER_S, FloatArray, IntArray


class ObservedController(EpController):
    """Answers states like an :class:`EpController`, with what a ``joint_trajectory_controller`` is doing.

    That one is sent the way to the start posture (:meth:`approach_points`), and, once the arm has settled
    (:attr:`settled`), the movement (:meth:`movement_points`), which begins at :attr:`run_from_ns`. It knows
    no safety layer: efforts are within their limits, and whatever else the layer would have changed acts.
    What the monitors find ends a trial as anywhere, and so does a stop; then the controller holds the posture
    that it is in, with its springs and the efforts of the last goal that it has reached. It does so too where
    readings or wiring cannot be trusted: nothing here can release the arm.
    """

    LOST_RAD = 1e-4
    """How far û may be from the network's where efforts are interpolated between points."""
    REMEMBERED = 2_000
    """States whose efforts :meth:`effort_at` knows."""

    def __init__(self, arm: ArmConfig, control: ControlConfig, safety: SafetyConfig | None = None) -> None:
        super().__init__(arm, control, safety)
        self.commands = self
        self._limit_nm = np.array(arm.effort_limit_nm)
        period_s = 1.0 / control.rate_hz
        self._periods_s = period_s, 1.0 / arm.controller_rate_hz if arm.controller_rate_hz else period_s
        self._rate_nm_per_s = EffortRate.of(arm, safety or SafetyConfig(), period_s).rate_nm_per_s
        self._held_rad: FloatArray | None = None
        self.reached_nm = np.zeros(len(arm.joints))
        """Efforts of the last point of the last goal that was reached: the controller's hold adds them."""
        self._exerted: deque[tuple[int, FloatArray]] = deque(maxlen=self.REMEMBERED)
        self.run_from_ns = 0
        """When the movement begins; 0: that is not known yet."""

    @property
    def settled(self) -> bool:
        """Whether the arm rests at the start posture, and the movement may be sent."""
        return self.phase is Phase.SETTLE and self._rest.still and not self.run_from_ns

    def effort_at(self, time_ns: int) -> FloatArray | None:
        """Return what should have acted from this time on, shape (n_joints,); None: it is not known."""
        for stamp_ns, effort_nm in reversed(self._exerted):
            if stamp_ns <= time_ns:
                return effort_nm if time_ns - stamp_ns < self._periods_s[0] * NS_PER_S else None
        return None

    def approach_points(self) -> TrajectoryPoints:
        """Return the way to the start posture, from the state in which the trial was taken up."""
        trial, period_s = self.course, self._periods_s[0]
        n = int(np.ceil(trial.approach.duration_ns / NS_PER_S / period_s)) + 1
        time_ns = np.rint(np.arange(n) * period_s * NS_PER_S).astype(np.int64)
        equilibrium = trial.approach.all_at(np.minimum(time_ns, round(trial.approach.duration_ns)))
        first = trial.points.first
        wanted = equilibrium - first.equilibrium + first.position
        velocity = np.gradient(wanted, time_ns / NS_PER_S, axis=0)
        velocity[[0, -1]] = 0.0
        acceleration = np.gradient(velocity, time_ns / NS_PER_S, axis=0)
        return self._points(time_ns, (wanted, velocity, acceleration), equilibrium)

    def movement_points(self, rest_ns: int) -> TrajectoryPoints:
        """Return the movement, after a rest at its start."""
        goal, desired = self.course.goal, self.course.goal.desired
        states = desired.position_rad, desired.velocity_rad_s, desired.acceleration_rad_s2
        points = self._points(desired.time_ns, states, goal.equilibrium_rad)
        return points.after(rest_ns, round(self._periods_s[0] * NS_PER_S))

    def _check_springs(self, goal: TrialGoal, springs: Springs) -> None:
        """Refuse efforts that grow faster than a safety layer would let them, and loads that make it sag."""
        super()._check_springs(goal, springs)
        desired, period_s, joints = goal.desired, self._periods_s[0], self.limits.joints
        effort = springs.effort(goal.equilibrium_rad, desired.position_rad, desired.velocity_rad_s)
        effort = effort.clip(-self._limit_nm, self._limit_nm)
        step_nm = self._rate_nm_per_s * period_s
        before, after = effort[:-1], effort[1:]
        sudden = (after < np.minimum(before, 0.0) - step_nm) | (after > np.maximum(before, 0.0) + step_nm)
        if sudden.any():
            k, j = np.argwhere(sudden)[0]
            raise TrajectoryError(
                f"the effort of {joints[j]} should go from {before[k, j]:.3g} N·m to {after[k, j]:.3g} N·m "
                f"within {period_s:.4g} s at {desired.time_s[k]:.3f} s; expected steps of at most "
                f"{step_nm[j]:.3g} N·m (safety.effort_rate_nm_per_s)"
            )
        # What the springs bear at rest. A load that is not learned yet shows as an error of the path.
        sag_rad = np.abs(goal.equilibrium_rad - desired.position_rad)[[0, -1]].max(axis=0)
        j, most_rad = int(np.argmax(sag_rad)), self.limits.path_tolerance_rad
        if sag_rad[j] > most_rad:
            stiffness = springs.stiffness_nm_per_rad[j]
            load_nm = sag_rad[j] * stiffness
            raise TrajectoryError(
                f"{joints[j]} bears {load_nm:.3g} N·m at rest: on an abort its controller holds without what "
                f"was learned, and it would sag by {sag_rad[j]:.3f} rad; expected at most the path tolerance "
                f"of {most_rad:g} rad. It needs a gain of {load_nm / most_rad:.3g} N·m/rad instead of "
                f"{stiffness:g}, or an arm that compensates its own weight"
            )

    def _points(
        self,
        time_ns: IntArray,
        states: tuple[FloatArray, FloatArray, FloatArray],
        equilibrium_rad: FloatArray,
    ) -> TrajectoryPoints:
        return TrajectoryPoints.of(
            self._springs,
            time_ns,
            states,
            equilibrium_rad,
            limit_nm=self._limit_nm,
            periods_s=self._periods_s,
            lost_rad=self.LOST_RAD,
        )

    def _begin(self, trial: TrialCourse, state: ArmState) -> bool:
        self.run_from_ns = 0
        return super()._begin(trial, state)

    def _run_begins_ns(self, state: ArmState) -> int:
        return self.run_from_ns if 0 < self.run_from_ns <= state.time_ns else 0

    def _target(self, trial: TrialCourse, state: ArmState) -> Target:
        if self.phase is not Phase.STOP:
            return super()._target(trial, state)
        if self._held_rad is None:
            self._held_rad = state.position_rad + self.reached_nm / self._springs.stiffness_nm_per_rad
        return Target.at_rest(self._held_rad)

    def _begin_stop(self, time_ns: int) -> None:
        self._held_rad = None
        super()._begin_stop(time_ns)

    def _distrust(self, reason: str) -> None:
        super()._distrust(f"{reason}; its controller holds it all the same: switch that off")
        self._releasing = False

    def _effort(self, state: ArmState, target: Target) -> Permitted:
        super()._effort(state, target)  # for what the monitors find
        wanted = self._springs.effort(target.equilibrium, state.position_rad, state.velocity_rad_s)
        permitted = self.safety.exerted(wanted)
        self._exerted_nm = permitted.effort_nm
        self._exerted.append((state.time_ns, self._exerted_nm))
        return permitted


def controller_of(arm: ArmConfig, control: ControlConfig, safety: SafetyConfig) -> EpController:
    """Return the controller for an arm, as its command interface demands."""
    kind = ObservedController if arm.command_interface == "trajectory" else EpController
    return kind(arm, control, safety)
