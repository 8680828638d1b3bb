"""Joint states that no arm can be in."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tel_ros.core.errors import StateError
from tel_ros.core.types import NS_PER_S, FloatArray

TIMES_THE_LIMIT = 10.0
"""A trial is aborted at the velocity limit itself; what is so far above it is no motion. Nor is a jump that
takes so many times the speed that the states tell."""
SMALL_JUMP_RAD = 0.1
"""A jump of less is left to the rules about motion: coarse encoders make small ones."""


class Plausibility:
    """Refuses states in which a joint is many times faster than it may be, or has jumped.

    Such a number comes from a broken message or a sensor that slipped. One answer to it is a kick with all
    the effort that there is, before anything else can notice: a damper brakes a speed that is not there. It
    is to be passed over, as if it had got lost; where it stays, that ends in a loss of the states. A position
    that stays elsewhere is believed once no other has come for the time-out.

    Args:
        joints: names.
        velocity_limit_rad_s: shape (n_joints,); may be infinite.
        timeout_s: longest time without a new state.
    """

    def __init__(self, joints: Sequence[str], velocity_limit_rad_s: FloatArray, timeout_s: float) -> None:
        self._joints = tuple(joints)
        self._fastest_rad_s = TIMES_THE_LIMIT * velocity_limit_rad_s
        self._timeout_ns = round(timeout_s * NS_PER_S)
        self._last_ns: int | None = None
        self._limit_rad_s = velocity_limit_rad_s
        self._position_rad = self._velocity_rad_s = np.zeros(len(joints))
        self._positions, self._fastest = self._position_rad.tolist(), self._fastest_rad_s.tolist()

    def require(self, time_ns: int, position_rad: FloatArray, velocity_rad_s: FloatArray) -> None:
        """Refuse a state, or remember it as the last one. Numbers that are not finite are not judged here.

        Args:
            time_ns: its stamp.
            position_rad: shape (n_joints,).
            velocity_rad_s: as reported, NaN where nothing was. Shape (n_joints,).

        Raises:
            StateError: a joint is too fast, or has jumped.
        """
        positions = position_rad.tolist()
        if self._last_ns is None or not self._is_ordinary(positions, velocity_rad_s.tolist()):
            self._judge(time_ns, position_rad, velocity_rad_s)
            if not np.isfinite(position_rad.sum()):
                return
        self._last_ns, self._position_rad, self._velocity_rad_s = time_ns, position_rad, velocity_rad_s
        self._positions = positions

    def _is_ordinary(self, positions: list[float], velocities: list[float]) -> bool:
        """Return whether no joint is too fast or has moved far: in the control loop this has to be quick."""
        for q, last, v, fastest in zip(positions, self._positions, velocities, self._fastest, strict=True):
            if not (-SMALL_JUMP_RAD <= q - last <= SMALL_JUMP_RAD and -fastest <= v <= fastest):
                return False  # or something is NaN
        return True

    def _judge(self, time_ns: int, position_rad: FloatArray, velocity_rad_s: FloatArray) -> None:
        told_rad_s = np.abs(velocity_rad_s)
        self._require_below(told_rad_s, self._fastest_rad_s, "moves at {:.6g} rad/s", "its velocity limit")
        last_ns = self._last_ns
        if last_ns is not None and 0 < time_ns - last_ns <= self._timeout_ns:
            # The limit itself where no speed is told, or a higher one.
            speed_rad_s = np.fmin(told_rad_s, self._limit_rad_s)
            before_rad_s = np.fmin(np.abs(self._velocity_rad_s), self._limit_rad_s)
            step_s = TIMES_THE_LIMIT * (time_ns - last_ns) / NS_PER_S
            furthest_rad = SMALL_JUMP_RAD + step_s * np.maximum(speed_rad_s, before_rad_s)
            jump_rad = np.abs(position_rad - self._position_rad)
            self._require_below(jump_rad, furthest_rad, "has jumped by {:.6g} rad", "what its speed explains")

    def _require_below(self, found: FloatArray, most: FloatArray, what: str, measure: str) -> None:
        beyond = found > most
        if beyond.any():
            j = int(np.argmax(beyond))
            raise StateError(
                f"the joint state says that {self._joints[j]} {what.format(found[j])}; expected at most "
                f"{most[j]:.6g} ({TIMES_THE_LIMIT:g} times {measure})"
            )
