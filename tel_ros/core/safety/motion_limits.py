"""Soft joint limits and the velocity limit, as bounds of the effort."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tel_ros.core.config import ArmConfig, SafetyConfig
from tel_ros.core.safety.effort_range import EffortRange
from tel_ros.core.types import FloatArray

LEAST_DAMPING_S = 0.05
"""Default k_velocity as a share of K, for joints with little damping of their own."""
DAMPING_FACTOR = 2.0
"""Default k_velocity as a multiple of B."""
WALL_STIFFNESS = 4.0
"""Default k_position · k_velocity, the stiffness of a soft limit, as a share of K."""
BEYOND_FACTOR = 2.0
"""How many times k_position counts beyond a soft limit."""
LARGEST_MARGIN_RAD = 0.1
MARGIN_SHARE = 0.025
"""Default distance of soft from hard limit: this share of the range, at most the largest margin."""


def soft_range(arm: ArmConfig, safety: SafetyConfig) -> tuple[FloatArray, FloatArray]:
    """Return the lower and upper soft limits in rad. Shapes (n_joints,)."""
    low, high = np.array(arm.position_min_rad), np.array(arm.position_max_rad)
    if safety.soft_margin_rad:
        margin = np.array(safety.soft_margin_rad)
    else:
        margin = np.minimum(MARGIN_SHARE * (high - low), LARGEST_MARGIN_RAD)
    return low + margin, high - margin


def wall_damping(arm: ArmConfig, safety: SafetyConfig) -> FloatArray:
    """Return k_velocity in N·m·s/rad. Shape (n_joints,)."""
    if safety.k_velocity_nms_per_rad:
        return np.array(safety.k_velocity_nms_per_rad)
    stiffness, damping = np.array(arm.stiffness_nm_per_rad), np.array(arm.damping_nms_per_rad)
    return np.maximum(DAMPING_FACTOR * damping, LEAST_DAMPING_S * stiffness)


@dataclass(frozen=True)
class MotionLimits:
    """Bounds the effort so that joints stay within soft limits and below a speed.

    The rule is that of the PR2's safety controller and of ros2_control's soft joint limits. A joint may move
    outward at v_max = k_position (q_soft − q) at most, and at v_limit at most, and the effort that may drive
    it outward is k_velocity (v_max − v); the same the other way round for the lower limit. Where that is
    negative it has to brake or to push back, whatever the command is. Two things are ours: beyond a soft
    limit k_position counts :data:`BEYOND_FACTOR` times, so that a weight cannot press far into it; and
    v_limit is a margin above the speed at which a trial is aborted, because a joint that moves at nearly that
    speed still needs effort against gravity and friction.

    By default k_position · k_velocity = 4 K and k_velocity = 2 B: no command can pull harder than springs
    would that are four times as stiff, have twice the damping and their equilibrium point at the soft limit.
    Gains that follow those of the arm's own springs suit heavy and light joints alike. Such a wall stops what
    is slow; what is fast is braked before (:mod:`~tel_ros.core.safety.braking_distance`).

    Sources: wiki.ros.org/pr2_controller_manager/safety_limits; urdf::JointSafety;
    joint_limits/src/joint_soft_limiter.cpp of ros2_control.

    Args:
        soft_min_rad: may be infinite, as all limits. Shape (n_joints,), as all of these.
        soft_max_rad: above ``soft_min_rad``.
        velocity_rad_s: v_limit.
        k_position_per_s: above 0.
        k_velocity_nms_per_rad: above 0.
    """

    soft_min_rad: FloatArray
    soft_max_rad: FloatArray
    velocity_rad_s: FloatArray
    k_position_per_s: FloatArray
    k_velocity_nms_per_rad: FloatArray

    @classmethod
    def of(cls, arm: ArmConfig, safety: SafetyConfig) -> MotionLimits:
        """Return the limits of a configured arm whose empty fields have been filled from its URDF."""
        low, high = soft_range(arm, safety)
        k_velocity = wall_damping(arm, safety)
        if safety.k_position_per_s:
            k_position = np.array(safety.k_position_per_s)
        else:
            k_position = WALL_STIFFNESS * np.array(arm.stiffness_nm_per_rad) / k_velocity
        return cls(
            soft_min_rad=low,
            soft_max_rad=high,
            velocity_rad_s=(1.0 + safety.velocity_margin) * np.array(arm.velocity_limit_rad_s),
            k_position_per_s=k_position,
            k_velocity_nms_per_rad=k_velocity,
        )

    def permitted(self, position_rad: FloatArray, velocity_rad_s: FloatArray) -> EffortRange:
        """Return the efforts that a measured state permits; not bounded by what the motors can do.

        Args:
            position_rad: shape (n_joints,).
            velocity_rad_s: shape (n_joints,).
        """
        up = self._fastest_outward(self.soft_max_rad - position_rad)
        down = self._fastest_outward(position_rad - self.soft_min_rad)
        k = self.k_velocity_nms_per_rad
        return EffortRange(k * (-down - velocity_rad_s), k * (up - velocity_rad_s))

    def _fastest_outward(self, room_rad: FloatArray) -> FloatArray:
        speed = self.k_position_per_s * np.minimum(room_rad, BEYOND_FACTOR * room_rad)
        return np.minimum(np.maximum(speed, -self.velocity_rad_s), self.velocity_rad_s)
