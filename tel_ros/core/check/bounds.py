"""How much a check may do to an arm: the one place that every effort of it passes."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tel_ros.core.config import ArmConfig
from tel_ros.core.errors import ConfigError
from tel_ros.core.types import FloatArray

MOST_EFFORT_SHARE = 0.10
MOST_RANGE_RAD = 0.2
MOST_STATE_GAP_S = 0.1
"""Without a state for at most this long everything ends with zero effort."""


@dataclass(frozen=True)
class PulseBounds:
    """What a person has agreed to.

    Args:
        effort_share: largest effort as a share of each joint's limit, up to :data:`MOST_EFFORT_SHARE`.
        range_rad: how far any joint may get from where it was, up to :data:`MOST_RANGE_RAD`.

    Raises:
        ConfigError: a value is not finite, not above 0 or above its maximum.
    """

    effort_share: float = 0.02
    range_rad: float = 0.05

    def __post_init__(self) -> None:
        for key, most, unit in (
            ("effort_share", MOST_EFFORT_SHARE, ""),
            ("range_rad", MOST_RANGE_RAD, " rad"),
        ):
            value = getattr(self, key)
            if not 0.0 < value <= most or not math.isfinite(value):
                raise ConfigError(key, value, f"above 0 and up to {most}{unit}")


class Guard:
    """Clips every effort, and says when to stop.

    Args:
        arm: names and effort limits.
        bounds: what is allowed.
        position_rad: where the arm is. Shape (n_joints,).
        now_s: on a clock that only runs forward.
        state_gap_s: no state for this long ends everything, up to :data:`MOST_STATE_GAP_S`.

    Raises:
        ConfigError: ``state_gap_s`` is out of its range.
    """

    def __init__(
        self,
        arm: ArmConfig,
        bounds: PulseBounds,
        position_rad: FloatArray,
        now_s: float,
        state_gap_s: float = MOST_STATE_GAP_S,
    ) -> None:
        if not 0.0 < state_gap_s <= MOST_STATE_GAP_S:
            raise ConfigError("state_gap_s", state_gap_s, f"above 0 and up to {MOST_STATE_GAP_S} s")
        self._state_gap_s = state_gap_s
        self.joints, self.bounds = arm.joints, bounds
        self.most_nm: FloatArray = bounds.effort_share * np.array(arm.effort_limit_nm)
        self.home_rad: FloatArray = position_rad.copy()
        self._seen_s = now_s
        self.complaint: str | None = None
        """Why everything has to end; stays once it is set."""
        self.mend = ""
        """What to do about the complaint."""

    def look(self, now_s: float, position_rad: FloatArray) -> bool:
        """Take in a state; return whether to go on."""
        self.look_at_clock(now_s)
        self._seen_s = now_s
        away_rad = np.abs(position_rad - self.home_rad)
        # Written so that NaN is outside.
        outside = ~(away_rad <= self.bounds.range_rad)
        if self.complaint is None and np.any(outside):
            j = int(np.argmax(outside))
            self.stop(
                f"{self.joints[j]} is {away_rad[j]:.4f} rad away from where it was "
                f"(allowed: {self.bounds.range_rad:g} rad)",
                "are the positions degrees instead of radians? Else less effort (--effort-share), or more "
                "room (--range)",
            )
        return self.complaint is None

    def look_at_clock(self, now_s: float) -> bool:
        """Take in that time has passed; return whether to go on."""
        if self.complaint is None and not now_s - self._seen_s <= self._state_gap_s:
            self.stop(
                f"no joint state for {self._state_gap_s:g} s",
                "the driver has stopped, or this machine is too busy: see rate and jitter",
            )
        return self.complaint is None

    def stop(self, reason: str, mend: str) -> None:
        """End everything for a reason that can be mended; the first one counts."""
        if self.complaint is None:
            self.complaint, self.mend = reason, mend

    def allowed(self, effort_nm: FloatArray) -> FloatArray:
        """Return an effort that may be sent: zero after a complaint or if it is not finite, else clipped."""
        if self.complaint is not None or not np.isfinite(effort_nm).all():
            return np.zeros_like(self.most_nm)
        return np.asarray(np.clip(effort_nm, -self.most_nm, self.most_nm), dtype=np.float64)
