"""Following a goal: its limits, where the arm should be now, and how well it does."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from tel_ros.core.arm_state import ArmState
from tel_ros.core.config import ArmConfig
from tel_ros.core.errors import TrajectoryError
from tel_ros.core.trajectories.trajectory import MINIMUM_JERK_PEAK_SPEED, minimum_jerk
from tel_ros.core.trial import Outcome, TrialGoal, TrialReport, require_joint_count
from tel_ros.core.types import NS_PER_S, BoolArray, FloatArray

_WAY_BACK_MARGIN_RAD = 0.02


class Target(NamedTuple):
    """Where the joints should be now, and what the springs pull towards. Shapes (n_joints,)."""

    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    equilibrium: FloatArray

    @classmethod
    def at_rest(cls, equilibrium: FloatArray) -> Target:
        """Return the target of springs that pull somewhere, with nothing else desired."""
        zero = np.zeros(len(equilibrium))
        return cls(equilibrium, zero, zero, equilibrium)


class GoalPoints:
    """The points of a goal, looked at from the first to the last."""

    def __init__(self, goal: TrialGoal) -> None:
        desired = goal.desired
        self._rows = (
            desired.position_rad,
            desired.velocity_rad_s,
            desired.acceleration_rad_s2,
            goal.equilibrium_rad,
        )
        self._times_ns: list[int] = desired.time_ns.tolist()
        self._point = 0
        self.end_ns = self._times_ns[-1]

    def first(self) -> Target:
        """Return the start."""
        return self._at(0, 0.0)

    def last(self) -> Target:
        """Return the end."""
        return self._at(len(self._times_ns) - 1, 0.0)

    def at(self, time_ns: int) -> Target:
        """Return the target at a time from the start, which must not go back from call to call."""
        times = self._times_ns
        k, last = self._point, len(times) - 1
        while k < last and times[k + 1] <= time_ns:
            k += 1
        self._point = k
        if k == last:
            return self.last()
        return self._at(k, float(time_ns - times[k]) / float(times[k + 1] - times[k]))

    def _at(self, k: int, share: float) -> Target:
        """Return the target at point k, or by linear interpolation between k and k + 1."""
        if share == 0.0:
            return Target(*(row[k] for row in self._rows))
        return Target(*((1.0 - share) * row[k] + share * row[k + 1] for row in self._rows))


@dataclass(frozen=True)
class Approach:
    """The way of the equilibrium points to the start posture, with minimum jerk.

    Args:
        start_rad: where they are. Shape (n_joints,).
        end_rad: where they go. Shape (n_joints,).
        speed_rad_s: of the joint with the longest way, at most.
    """

    SHORTEST_S = 0.5

    start_rad: FloatArray
    end_rad: FloatArray
    speed_rad_s: float

    @cached_property
    def duration_ns(self) -> float:
        """How long it takes."""
        distance_rad = float(np.abs(self.end_rad - self.start_rad).max())
        return max(MINIMUM_JERK_PEAK_SPEED * distance_rad / self.speed_rad_s, self.SHORTEST_S) * NS_PER_S

    def at(self, time_ns: int) -> FloatArray:
        """Return the equilibrium points at a time from the start. Shape (n_joints,)."""
        s = minimum_jerk(np.array([time_ns / self.duration_ns]))[0][0]
        equilibrium_rad: FloatArray = self.start_rad + s * (self.end_rad - self.start_rad)
        return equilibrium_rad


@dataclass(frozen=True)
class Limits:
    """What a goal may ask for, and what ends a trial. Arrays of shape (n_joints,).

    The path tolerance is the largest allowed distance of any joint from its desired position.
    """

    joints: tuple[str, ...]
    position_min_rad: FloatArray
    position_max_rad: FloatArray
    velocity_rad_s: FloatArray
    path_tolerance_rad: float

    @classmethod
    def of(cls, arm: ArmConfig, path_tolerance_rad: float) -> Limits:
        """Return the limits of a configured arm whose empty fields have been filled from its URDF."""
        low, high, fastest = map(
            np.array, (arm.position_min_rad, arm.position_max_rad, arm.velocity_limit_rad_s)
        )
        return cls(arm.joints, low, high, fastest, path_tolerance_rad)

    def reaching(self, position_rad: FloatArray) -> Limits:
        """Return limits whose range includes where the arm is, so that it may come back from outside."""
        return replace(
            self,
            position_min_rad=np.minimum(self.position_min_rad, position_rad - _WAY_BACK_MARGIN_RAD),
            position_max_rad=np.maximum(self.position_max_rad, position_rad + _WAY_BACK_MARGIN_RAD),
        )

    def check_goal(self, goal: TrialGoal, rest_speed_rad_s: float) -> None:
        """Refuse a goal that the arm must not or cannot follow.

        Raises:
            TrajectoryError: wrong number of joints, desired positions or velocities outside the limits,
                or a desired trajectory that does not start and end at rest.
        """
        require_joint_count(goal, len(self.joints))
        desired = goal.desired
        for values, low, high, unit in (
            (desired.position_rad, self.position_min_rad, self.position_max_rad, "rad"),
            (desired.velocity_rad_s, -self.velocity_rad_s, self.velocity_rad_s, "rad/s"),
        ):
            outside = (values < low) | (values > high)
            if np.any(outside):
                k, j = np.argwhere(outside)[0]
                raise TrajectoryError(
                    f"{self.joints[j]} should be at {values[k, j]:.3f} {unit} at {desired.time_s[k]:.3f} s; "
                    f"expected {low[j]:.3f} to {high[j]:.3f} {unit}"
                )
        ends = np.abs(desired.velocity_rad_s[[0, -1]])
        if np.any(ends > rest_speed_rad_s):
            raise TrajectoryError(
                f"the desired trajectory starts or ends with {ends.max():.3f} rad/s; expected rest "
                f"(up to {rest_speed_rad_s} rad/s)"
            )

    def violation(self, state: ArmState, desired_rad: FloatArray) -> str | None:
        """Return what is wrong with a measured state in words, or None if it is inside all limits."""
        if self._is_inside(state, desired_rad):
            return None
        error = np.abs(state.position_rad - desired_rad)
        speed = np.abs(state.velocity_rad_s)
        j = int(np.argmax(error))
        if error[j] > self.path_tolerance_rad:
            return (
                f"{self.joints[j]} is {error[j]:.3f} rad off its desired position "
                f"(path tolerance {self.path_tolerance_rad:.3f} rad)"
            )
        j = int(np.argmax(speed / self.velocity_rad_s))
        if speed[j] > self.velocity_rad_s[j]:
            return (
                f"{self.joints[j]} moves at {state.velocity_rad_s[j]:.2f} rad/s "
                f"(limit {self.velocity_rad_s[j]:.2f} rad/s)"
            )
        beyond = np.maximum(
            self.position_min_rad - state.position_rad, state.position_rad - self.position_max_rad
        )
        j = int(np.argmax(beyond))
        return (
            f"{self.joints[j]} is at {state.position_rad[j]:.3f} rad "
            f"(limits {self.position_min_rad[j]:.3f} to {self.position_max_rad[j]:.3f} rad)"
        )

    @cached_property
    def _by_joint(self) -> list[tuple[float, float, float]]:
        arrays = (self.position_min_rad, self.position_max_rad, self.velocity_rad_s)
        return list(zip(*(array.tolist() for array in arrays), strict=True))

    def _is_inside(self, state: ArmState, desired_rad: FloatArray) -> bool:
        """Return whether all is well. In the control loop: so few numbers are compared faster one by one."""
        far = self.path_tolerance_rad
        positions, velocities = state.position_rad.tolist(), state.velocity_rad_s.tolist()
        for (low, high, fastest), q, v, wanted in zip(
            self._by_joint, positions, velocities, desired_rad.tolist(), strict=True
        ):
            if not (low <= q <= high and -far <= q - wanted <= far and -fastest <= v <= fastest):
                return False
        return True


class TrackingScore:
    """Tracking error, effort and saturation over the ticks of RUN; NaN before the first of them."""

    def __init__(self, n_joints: int) -> None:
        self.ticks = 0
        # Lists: in the control loop so few numbers are faster one by one than as arrays.
        self._largest_rad = [0.0] * n_joints
        self._largest_nm = [0.0] * n_joints
        self._squares = [0.0] * n_joints
        self._saturated = 0

    def add(self, error_rad: FloatArray, effort_nm: FloatArray, saturated: BoolArray) -> None:
        """Take in one tick. Shapes (n_joints,)."""
        self.ticks += 1
        for j, (error, effort) in enumerate(zip(error_rad.tolist(), effort_nm.tolist(), strict=True)):
            self._squares[j] += error * error
            self._largest_rad[j] = max(self._largest_rad[j], abs(error))
            self._largest_nm[j] = max(self._largest_nm[j], abs(effort))
        self._saturated += any(saturated.tolist())

    @property
    def max_effort_nm(self) -> FloatArray:
        """Largest effort of each joint so far, 0 before the first tick. Shape (n_joints,)."""
        return np.array(self._largest_nm)

    @property
    def rms_error_per_joint_rad(self) -> FloatArray:
        """Root mean square error of each joint. Shape (n_joints,)."""
        if self.ticks == 0:
            return np.full(len(self._squares), np.nan)
        return np.sqrt(np.array(self._squares) / self.ticks)

    @property
    def rms_error_rad(self) -> float:
        """Root mean square error over all joints and ticks."""
        return float(np.sqrt(np.mean(self.rms_error_per_joint_rad**2)))

    @property
    def max_error_rad(self) -> float:
        """Largest deviation of any joint."""
        return max(self._largest_rad) if self.ticks else float("nan")

    @property
    def saturated_ratio(self) -> float:
        """Share of the ticks in which the effort of some joint had to be changed."""
        return self._saturated / self.ticks if self.ticks else float("nan")


class TrialCourse:
    """The books of one trial."""

    def __init__(self, goal: TrialGoal) -> None:
        self.goal, self.points = goal, GoalPoints(goal)
        self.score = TrackingScore(goal.desired.n_joints)
        self.outcome, self.message = Outcome.COMPLETED, ""
        self.ticks = self.start_ns = self.run_ns = 0
        """States that were answered; stamps of the first one, and of the first one in RUN."""

    def report(self, end_ns: int) -> TrialReport:
        """Return how the trial went that ends now."""
        return TrialReport(
            index=self.goal.index,
            alpha=self.goal.alpha,
            duration_s=self.goal.desired.duration_s,
            outcome=self.outcome,
            message=self.message,
            start_ns=self.start_ns,
            run_ns=self.run_ns,
            end_ns=end_ns,
            ticks=self.ticks,
            rms_error_rad=self.score.rms_error_rad,
            rms_error_per_joint_rad=self.score.rms_error_per_joint_rad,
            max_error_rad=self.score.max_error_rad,
            max_effort_nm=self.score.max_effort_nm,
            saturated_ratio=self.score.saturated_ratio,
        )
