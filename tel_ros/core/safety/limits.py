"""What a goal may ask for, and what a moving arm may not do."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from tel_ros.core.arm_state import ArmState
from tel_ros.core.config import ArmConfig
from tel_ros.core.errors import TrajectoryError
from tel_ros.core.trial import TrialGoal, require_joint_count
from tel_ros.core.types import FloatArray

_WAY_BACK_MARGIN_RAD = 0.02


@dataclass(frozen=True)
class Limits:
    """The bounds of an arm and the width of the corridor around its path.

    Args:
        joints: names, for messages.
        position_min_rad: shape (n_joints,).
        position_max_rad: shape (n_joints,).
        velocity_rad_s: shape (n_joints,).
        path_tolerance_rad: largest allowed distance of any joint from its desired position.
    """

    joints: tuple[str, ...]
    position_min_rad: FloatArray
    position_max_rad: FloatArray
    velocity_rad_s: FloatArray
    path_tolerance_rad: float

    @classmethod
    def of(cls, arm: ArmConfig, path_tolerance_rad: float) -> Limits:
        """Return the limits of a configured arm whose empty fields have been filled from its URDF."""
        return cls(
            joints=arm.joints,
            position_min_rad=np.array(arm.position_min_rad),
            position_max_rad=np.array(arm.position_max_rad),
            velocity_rad_s=np.array(arm.velocity_limit_rad_s),
            path_tolerance_rad=path_tolerance_rad,
        )

    @cached_property
    def _by_joint(self) -> list[tuple[float, float, float]]:
        arrays = (self.position_min_rad, self.position_max_rad, self.velocity_rad_s)
        return list(zip(*(array.tolist() for array in arrays), strict=True))

    def _is_inside(self, state: ArmState, desired_rad: FloatArray) -> bool:
        """Return whether all is well. In the control loop: so few numbers are compared faster one by one."""
        corridor = self.path_tolerance_rad
        positions, velocities = state.position_rad.tolist(), state.velocity_rad_s.tolist()
        for (low, high, fastest), q, v, wanted in zip(
            self._by_joint, positions, velocities, desired_rad.tolist(), strict=True
        ):
            if not (low <= q <= high and -corridor <= q - wanted <= corridor and -fastest <= v <= fastest):
                return False
        return True

    def reaching(self, position_rad: FloatArray) -> Limits:
        """Return limits whose range reaches to a posture outside, so that the arm may come back from there.

        Args:
            position_rad: where the arm is. Shape (n_joints,).
        """
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
                f"(corridor {self.path_tolerance_rad:.3f} rad)"
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
