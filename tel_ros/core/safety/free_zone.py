"""Where no rule of the safety layer has anything to say."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tel_ros.core.arm_state import ArmState
from tel_ros.core.safety.braking_distance import BrakingDistance
from tel_ros.core.safety.effort_range import EffortRange
from tel_ros.core.safety.effort_rate import EffortRate
from tel_ros.core.safety.motion_limits import MotionLimits
from tel_ros.core.types import NS_PER_S, FloatArray

_SHARE_OF_PERIOD = 0.5
"""The rate of efforts is judged as if this share of a control period had passed."""
_ROUNDING = 1.0 - 1e-9
"""What lies this close to a bound is left to the rules themselves."""


@dataclass(frozen=True)
class FreeZone:
    """One test in place of all rules, for the many ticks in which an arm is far from everything.

    It may only err to one side: an effort in the zone passes every rule; one outside may pass them as well.
    Far from its soft limits, by ``room`` rad, a joint has

    - all of its velocity limit free, so that the soft limits ask for abs(τ + k v) ≤ k v_limit alone
      (:class:`~tel_ros.core.safety.motion_limits.MotionLimits`);
    - √(2 a room) and more to brake from (:class:`~tel_ros.core.safety.braking_distance.BrakingDistance`).

    Args:
        centre_rad: middle of the soft range. Shape (n_joints,).
        k_velocity_nms_per_rad: k. Shape (n_joints,).
        bounds: of the absolute values of τ − τ_last, τ, τ + k v, v, q − centre, one joint beside the other.
            Shape (5 n_joints,).
        shortest_ns: time since the last effort from which on the zone holds.
    """

    centre_rad: FloatArray
    k_velocity_nms_per_rad: FloatArray
    bounds: FloatArray
    shortest_ns: int

    @classmethod
    def of(
        cls,
        rate: EffortRate,
        braking: BrakingDistance,
        motion: MotionLimits,
        limit: EffortRange,
        period_s: float,
    ) -> FreeZone:
        """Return the zone that these rules leave free."""
        low, high = motion.soft_min_rad, motion.soft_max_rad
        bounded = np.isfinite(low) & np.isfinite(high)
        centre = np.where(bounded, 0.5 * (np.where(bounded, low, 0.0) + np.where(bounded, high, 0.0)), 0.0)
        room = motion.velocity_rad_s / motion.k_position_per_s
        reach = np.minimum(high - centre, centre - low) - room
        fastest = braking.creep_rad_s + np.sqrt(2.0 * braking.deceleration_rad_s2 * room)
        k = motion.k_velocity_nms_per_rad
        step = rate.rate_nm_per_s * _SHARE_OF_PERIOD * period_s
        bounds = np.concatenate([step, limit.high_nm, k * motion.velocity_rad_s, fastest, reach])
        return cls(centre, k, _ROUNDING * bounds, round(_SHARE_OF_PERIOD * period_s * NS_PER_S) + 1)

    def has(self, state: ArmState, wanted_nm: FloatArray, last_nm: FloatArray) -> bool:
        """Return whether an effort that follows the last one, in a state, is in the zone.

        Args:
            state: as measured.
            wanted_nm: NaN is never in the zone. Shape (n_joints,).
            last_nm: shape (n_joints,).
        """
        for (centre, k, step, most, most_with_damping, fastest, reach), q, v, wanted, last in zip(
            self._by_joint,
            state.position_rad.tolist(),
            state.velocity_rad_s.tolist(),
            wanted_nm.tolist(),
            last_nm.tolist(),
            strict=True,
        ):
            # In the control loop: so few numbers are compared faster one by one than as arrays.
            if not (
                -step <= wanted - last <= step
                and -most <= wanted <= most
                and -most_with_damping <= wanted + k * v <= most_with_damping
                and -fastest <= v <= fastest
                and -reach <= q - centre <= reach
            ):
                return False
        return True

    @cached_property
    def _by_joint(self) -> list[tuple[float, ...]]:
        rows = (self.centre_rad, self.k_velocity_nms_per_rad, *self.bounds.reshape(5, -1))
        return list(zip(*(row.tolist() for row in rows), strict=True))
