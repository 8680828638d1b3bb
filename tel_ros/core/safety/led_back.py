"""Joints that are found beyond their soft limits are led back, not flung."""

from __future__ import annotations

import numpy as np

from tel_ros.core.config import ArmConfig
from tel_ros.core.safety.motion_limits import MotionLimits
from tel_ros.core.types import NS_PER_S, FloatArray

SPEED_SHARE = 0.05
"""How fast a soft limit goes back to its place: this share of the joint's velocity limit."""


class LedBack:
    """Puts soft limits behind the joints that are found beyond them, and moves them back to their places.

    A soft limit is a stiff spring. On an arm that fell while nobody commanded it, and now leans against the
    end of its range, it would act at once with all that it is compressed by: up to 300 N·m on a joint of
    the simulated iiwa, which was thrown inside with 2.6 rad/s. So a limit acts where the joint is found, and
    takes it along from there; while the motors do not act it waits for the joint (:meth:`find` again), or it
    would be compressed just the same by the time they do.

    Args:
        motion: the soft limits.
        speed_rad_s: above 0. Shape (n_joints,).
    """

    def __init__(self, motion: MotionLimits, speed_rad_s: FloatArray) -> None:
        self._motion, self._speed_rad_s = motion, speed_rad_s
        self._shift_rad: FloatArray | None = None
        self._since_ns = 0

    @classmethod
    def of(cls, arm: ArmConfig, motion: MotionLimits) -> LedBack:
        """Return it for a configured arm whose empty limits have been filled from its URDF."""
        return cls(motion, SPEED_SHARE * np.array(arm.velocity_limit_rad_s))

    @property
    def leads(self) -> bool:
        """Whether a soft limit is not in its place."""
        return self._shift_rad is not None

    def find(self, time_ns: int, position_rad: FloatArray) -> None:
        """Take in where an arm is that its motors have not held until now. Shape (n_joints,)."""
        inside = np.clip(position_rad, self._motion.soft_min_rad, self._motion.soft_max_rad)
        shift_rad = position_rad - inside
        self._shift_rad, self._since_ns = (shift_rad if shift_rad.any() else None), time_ns

    def seen_from_limits(self, time_ns: int, position_rad: FloatArray) -> FloatArray:
        """Return the position to compare with the soft limits in their places. Shape (n_joints,)."""
        if self._shift_rad is None:
            return position_rad
        step_rad = self._speed_rad_s * max(0.0, (time_ns - self._since_ns) / NS_PER_S)
        shift_rad = np.sign(self._shift_rad) * np.maximum(np.abs(self._shift_rad) - step_rad, 0.0)
        if not shift_rad.any():
            self._shift_rad = None
        seen_rad: FloatArray = position_rad - shift_rad
        return seen_rad
