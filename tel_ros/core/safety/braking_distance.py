"""How fast a joint may move towards a limit: so that it can still be braked."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tel_ros.core.config import ArmConfig, SafetyConfig
from tel_ros.core.safety.effort_range import EffortRange
from tel_ros.core.safety.motion_limits import LEAST_DAMPING_S, soft_range, wall_damping
from tel_ros.core.types import FloatArray

LEAST_DAMPING_RATIO = 0.3
"""Of the springs with the arm stretched out, as docs/real-arm.md asks for: it bounds the inertia to brake."""
BRAKING_SHARE = 0.5
"""Default deceleration: what this share of the effort limit gives that inertia."""
CREEP_SHARE = 0.1
"""Up to this share of its velocity limit the soft walls alone stop a joint."""
GAIN = 10.0
"""With how many times the soft walls' damping a joint is braked that is too fast."""
BAND = 0.15
"""How far above the speed that can still be braked, as a share of it, no effort is left towards the limit."""
_FAR_RAD = 1e9
NO_BOUNDS = EffortRange(np.array(-np.inf), np.array(np.inf))
"""For any number of joints."""


@dataclass(frozen=True)
class BrakingDistance:
    """Takes the effort away from a joint that comes too fast to a soft limit, and brakes it.

    Within a distance d of a soft limit, a joint that can be braked with the deceleration a may be as fast as
    √(2 a d). Up to that speed its effort is free. Above it there is less and less effort towards the limit,
    and then effort away from it, up to all that there is.

    The default of a takes the springs' word for the inertia: K and B damp an inertia I with the ratio
    ζ = B / (2 √(K I)), and with ζ of at least 0.3 it is I = B² / (0.36 K) at most.

    Args:
        soft_min_rad: may be infinite, as all limits. Shape (n_joints,), as all of these.
        soft_max_rad: above ``soft_min_rad``.
        creep_rad_s: speed that is always allowed.
        deceleration_rad_s2: a, above 0.
        gain_nms_per_rad: effort against each rad/s that a joint is too fast, above 0.
        effort_limit_nm: what there is to brake with.
    """

    soft_min_rad: FloatArray
    soft_max_rad: FloatArray
    creep_rad_s: FloatArray
    deceleration_rad_s2: FloatArray
    gain_nms_per_rad: FloatArray
    effort_limit_nm: FloatArray

    @classmethod
    def of(cls, arm: ArmConfig, safety: SafetyConfig) -> BrakingDistance:
        """Return the rule for a configured arm whose empty fields have been filled from its URDF."""
        low, high = soft_range(arm, safety)
        effort = np.array(arm.effort_limit_nm)
        if safety.deceleration_rad_s2:
            deceleration = np.array(safety.deceleration_rad_s2)
        else:
            stiffness = np.array(arm.stiffness_nm_per_rad)
            damping = np.maximum(np.array(arm.damping_nms_per_rad), LEAST_DAMPING_S * stiffness)
            inertia = damping**2 / ((2.0 * LEAST_DAMPING_RATIO) ** 2 * stiffness)
            deceleration = BRAKING_SHARE * effort / inertia
        creep = CREEP_SHARE * np.array(arm.velocity_limit_rad_s)
        return cls(low, high, creep, deceleration, GAIN * wall_damping(arm, safety), effort)

    def permitted(self, position_rad: FloatArray, velocity_rad_s: FloatArray) -> EffortRange:
        """Return the efforts that a measured state permits; infinite where there is nothing to brake.

        Args:
            position_rad: shape (n_joints,).
            velocity_rad_s: shape (n_joints,).
        """
        speed = np.abs(velocity_rad_s)
        # Most ticks end here or below: this is in the control loop.
        if (speed <= self.creep_rad_s).all():
            return NO_BOUNDS
        upward = velocity_rad_s > 0.0
        room = np.where(upward, self.soft_max_rad - position_rad, position_rad - self.soft_min_rad)
        room = np.minimum(np.maximum(room, 0.0), _FAR_RAD)
        fastest = np.sqrt(2.0 * self.deceleration_rad_s2 * room) + self.creep_rad_s
        too_fast = speed > fastest
        if not too_fast.any():
            return NO_BOUNDS
        gain, limit = self.gain_nms_per_rad, self.effort_limit_nm
        braking = gain * (fastest - speed) + np.minimum(limit, gain * BAND * fastest)
        outward = np.where(too_fast, np.maximum(braking, -limit), np.inf)
        return EffortRange(np.where(upward, -np.inf, -outward), np.where(upward, outward, np.inf))
