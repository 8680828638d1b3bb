"""How fast an effort may change."""

from __future__ import annotations

import numpy as np

from tel_ros.core.config import ArmConfig, SafetyConfig
from tel_ros.core.safety.effort_range import EffortRange
from tel_ros.core.types import FloatArray

FULL_SWING_S = 0.02
"""Default: from one limit to the opposite one within this time."""


class EffortRate:
    """Lets efforts grow by so much in a time, and fall to zero at once.

    A jump of the effort shakes an arm and strains its gears; so does one from a full push to a full pull. But
    letting go is never held up: a limiter that went on pushing would make every stop a later one. Between the
    last effort τ and the next one there are at most ``rate`` · Δt, counted from zero where the sign changes:
    min(τ, 0) − rate Δt … max(τ, 0) + rate Δt.

    Args:
        rate_nm_per_s: above 0, one a joint. Shape (n_joints,).
    """

    def __init__(self, rate_nm_per_s: FloatArray) -> None:
        self.rate_nm_per_s = rate_nm_per_s

    @classmethod
    def of(cls, arm: ArmConfig, safety: SafetyConfig) -> EffortRate:
        """Return the configured rate, or for an empty one that which crosses the limits in 20 ms."""
        if safety.effort_rate_nm_per_s:
            return cls(np.array(safety.effort_rate_nm_per_s))
        return cls(2.0 * np.array(arm.effort_limit_nm) / FULL_SWING_S)

    def permitted(self, last_nm: FloatArray, elapsed_s: float) -> EffortRange:
        """Return what may follow an effort after a time. ``last_nm`` has shape (n_joints,)."""
        step_nm = self.rate_nm_per_s * elapsed_s
        return EffortRange(np.minimum(last_nm, 0.0) - step_nm, np.maximum(last_nm, 0.0) + step_nm)

    def towards_zero(self, last_nm: FloatArray, elapsed_s: float) -> FloatArray:
        """Return the effort that follows when it is let go as slowly as it may grow."""
        step_nm = self.rate_nm_per_s * elapsed_s
        return np.where(np.abs(last_nm) > step_nm, last_nm - np.copysign(step_nm, last_nm), 0.0)
