"""Following a goal: its limits, where the arm should be now, and how well it does."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from tel_ros.core.arm_state import ArmState
from tel_ros.core.config import ArmConfig
from tel_ros.core.errors import TrajectoryError, counted
from tel_ros.core.trajectories.timing import MINIMUM_JERK_PEAK_SPEED, minimum_jerk
from tel_ros.core.trial import Outcome, Phase, Tick, TrialGoal, TrialReport
from tel_ros.core.types import NS_PER_S, FloatArray, IntArray

_WAY_BACK_MARGIN_RAD = 0.02
_MISPLACED_RAD = 0.05
"""Joints are found this far beyond their range at most: where a stop gives way, or a zero is not exact."""


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
        y, velocity, acceleration = desired.position_rad, desired.velocity_rad_s, desired.acceleration_rad_s2
        self._rows = (y, velocity, acceleration, goal.equilibrium_rad)
        self.first, self.last = (Target(*(row[k] for row in self._rows)) for k in (0, -1))
        self._times_ns: list[int] = desired.time_ns.tolist()
        self._point = 0
        self.end_ns = self._times_ns[-1]

    def at(self, time_ns: int) -> Target:
        """Return the target at a time from the start, which must not go back: linear between two points."""
        times = self._times_ns
        k, last = self._point, len(times) - 1
        while k < last and times[k + 1] <= time_ns:
            k += 1
        self._point = k
        if k == last:
            return self.last
        if time_ns == times[k]:
            y, velocity, acceleration, u = self._rows
            return Target(y[k], velocity[k], acceleration[k], u[k])
        share = float(time_ns - times[k]) / float(times[k + 1] - times[k])
        return Target(*((1.0 - share) * row[k] + share * row[k + 1] for row in self._rows))


class Approach:
    """The way of the equilibrium points to the start posture, with minimum jerk.

    ``speed_rad_s`` is the peak speed of the joint with the longest way. Shapes (n_joints,).
    """

    SHORTEST_S = 0.5

    def __init__(self, start_rad: FloatArray, end_rad: FloatArray, speed_rad_s: float) -> None:
        self._start_rad, self._way_rad = start_rad, end_rad - start_rad
        longest_s = MINIMUM_JERK_PEAK_SPEED * float(np.abs(self._way_rad).max()) / speed_rad_s
        self.duration_ns = max(longest_s, self.SHORTEST_S) * NS_PER_S

    def at(self, time_ns: int) -> FloatArray:
        """Return the equilibrium points at a time from the start."""
        equilibrium_rad: FloatArray = self.all_at(np.array([time_ns]))[0]
        return equilibrium_rad

    def all_at(self, time_ns: IntArray) -> FloatArray:
        """Return them at several times, shape (n, n_joints)."""
        s = minimum_jerk(time_ns / self.duration_ns)[0]
        equilibrium_rad: FloatArray = self._start_rad + s[:, None] * self._way_rad
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
        low, high = np.array(arm.position_min_rad), np.array(arm.position_max_rad)
        return cls(arm.joints, low, high, np.array(arm.velocity_limit_rad_s), path_tolerance_rad)

    def reaching(self, position_rad: FloatArray) -> Limits:
        """Return limits whose range includes where the arm is, so that it may come back from outside."""
        return replace(
            self,
            position_min_rad=np.minimum(self.position_min_rad, position_rad - _WAY_BACK_MARGIN_RAD),
            position_max_rad=np.maximum(self.position_max_rad, position_rad + _WAY_BACK_MARGIN_RAD),
        )

    def misplaced(self, position_rad: FloatArray) -> str:
        """Return which joint is where it cannot be, in words; nothing if none is."""
        low, high = self.position_min_rad, self.position_max_rad
        beyond = np.maximum(low - position_rad, position_rad - high)
        j = int(np.argmax(beyond))
        if beyond[j] <= _MISPLACED_RAD:
            return ""
        return (
            f"{self.joints[j]} is at {position_rad[j]:.3f} rad, outside of its range of {low[j]:.3f} to "
            f"{high[j]:.3f} rad: move it back by hand, or look for a wrong unit, sign or order of joints "
            "(tel check)"
        )

    def too_fast(self, state: ArmState) -> bool:
        """Return whether a joint is above its velocity limit."""
        return bool((np.abs(state.velocity_rad_s) > self.velocity_rad_s).any())

    def check_goal(self, goal: TrialGoal, rest_speed_rad_s: float) -> None:
        """Refuse a goal that the arm must not or cannot follow.

        Raises TrajectoryError: wrong number of joints, desired positions or velocities outside the limits, or
        a desired trajectory that does not start and end at rest.
        """
        desired, n_joints = goal.desired, len(self.joints)
        if desired.n_joints != n_joints:
            raise TrajectoryError(f"the goal has {counted(desired.n_joints, 'joint')}; expected {n_joints}")
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
        far = self.path_tolerance_rad
        # In the control loop: so few numbers are compared faster one by one.
        for (low, high, fastest), q, v, wanted in zip(
            self._by_joint, state.positions, state.velocities, desired_rad.tolist()
        ):
            if not (low <= q <= high and -far <= q - wanted <= far and -fastest <= v <= fastest):
                break
        else:
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
            limit = f"limit {self.velocity_rad_s[j]:.2f} rad/s"
            return f"{self.joints[j]} moves at {state.velocity_rad_s[j]:.2f} rad/s ({limit})"
        position, lowest, highest = state.position_rad, self.position_min_rad, self.position_max_rad
        j = int(np.argmax(np.maximum(lowest - position, position - highest)))
        limits = f"limits {lowest[j]:.3f} to {highest[j]:.3f} rad"
        return f"{self.joints[j]} is at {position[j]:.3f} rad ({limits})"

    @cached_property
    def _by_joint(self) -> list[tuple[float, float, float]]:
        arrays = (self.position_min_rad, self.position_max_rad, self.velocity_rad_s)
        return list(zip(*(array.tolist() for array in arrays), strict=True))


class TrackingScore:
    """Tracking error, effort and saturation over the ticks of RUN; NaN before the first of them."""

    def __init__(self, n_joints: int) -> None:
        self.ticks = 0
        # Lists: in the control loop so few numbers are faster one by one than as arrays.
        self._largest_rad = [0.0] * n_joints
        self._largest_nm = [0.0] * n_joints
        self._squares = [0.0] * n_joints
        self._saturated = 0

    def add(self, state: ArmState, tick: Tick) -> None:
        """Take in one tick."""
        self.ticks += 1
        squares, farthest, strongest = self._squares, self._largest_rad, self._largest_nm
        rows = zip(state.positions, tick.desired_position_rad.tolist(), tick.effort_nm.tolist())
        for j, (q, wanted, effort) in enumerate(rows):
            error = q - wanted
            squares[j] += error * error
            if not -farthest[j] <= error <= farthest[j]:
                farthest[j] = abs(error)
            if not -strongest[j] <= effort <= strongest[j]:
                strongest[j] = abs(effort)
        self._saturated += any(tick.saturated.tolist())

    @property
    def max_error_rad(self) -> float:
        """Largest deviation of any joint."""
        return max(self._largest_rad) if self.ticks else math.nan

    def figures(self) -> dict[str, Any]:
        """Return all of it under the names that a report has for it."""
        squares, n = np.array(self._squares), self.ticks
        per_joint_rad = np.sqrt(squares / n) if n else np.full(len(squares), np.nan)
        return {
            "rms_error_rad": float(np.sqrt(np.mean(per_joint_rad**2))),
            "rms_error_per_joint_rad": per_joint_rad,
            "max_error_rad": self.max_error_rad,
            "max_effort_nm": np.array(self._largest_nm),
            "saturated_ratio": self._saturated / n if n else math.nan,
        }


class TrialCourse:
    """The books of one trial."""

    def __init__(self, goal: TrialGoal) -> None:
        self.goal, self.points = goal, GoalPoints(goal)
        self.score = TrackingScore(goal.desired.n_joints)
        self.outcome, self.message = Outcome.COMPLETED, ""
        self.ticks = self.start_ns = self.run_ns = 0
        """States that were answered; stamps of the first one, and of the first one in RUN."""
        self.approach: Approach
        self.way_back: Limits
        """Known from APPROACH on: the way to the start posture, and the limits on it."""

    def target(self, phase: Phase, in_phase_ns: int) -> Target:
        """Return where the arm should be now, in any phase of the trial but STOP."""
        if phase is Phase.RUN:
            return self.points.at(in_phase_ns)
        if phase is Phase.APPROACH:
            return Target.at_rest(self.approach.at(in_phase_ns))
        return self.points.first if phase is Phase.SETTLE else self.points.last

    def wanted_rad(self, phase: Phase, target: Target) -> FloatArray:
        """Return the position of a target without what was learned. Shape (n_joints,)."""
        if phase is not Phase.APPROACH:
            return target.position
        first = self.points.first  # to where the approach leads the learned effort acts as well
        return target.position - first.equilibrium + first.position

    def report(self, end_ns: int, remarks: Sequence[str] = ()) -> TrialReport:
        """Return how the trial went that ends now."""
        return TrialReport(
            index=self.goal.index,
            alpha=self.goal.alpha,
            duration_s=self.goal.desired.duration_s,
            outcome=self.outcome,
            message="; ".join(filter(None, (self.message, *remarks))),
            start_ns=self.start_ns,
            run_ns=self.run_ns,
            end_ns=end_ns,
            ticks=self.ticks,
            **self.score.figures(),
        )
