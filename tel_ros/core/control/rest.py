"""Telling whether an arm is at rest."""

from __future__ import annotations

from tel_ros.core.types import NS_PER_S, FloatArray


class RestDetector:
    """Says when no joint has moved for a while.

    It looks at positions over the whole window instead of at the measured velocity, which a coarse encoder
    or noise can keep above any sensible threshold although the arm stands still.

    Args:
        speed_rad_s: mean speed over the window below which a joint counts as at rest.
        window_s: length of the window.
    """

    def __init__(self, speed_rad_s: float, window_s: float) -> None:
        self._distance_rad = speed_rad_s * window_s
        self._window_ns = round(window_s * NS_PER_S)
        self._since_ns = 0
        self._reference_rad: list[float] | None = None

    def at_rest(self, time_ns: int, position_rad: FloatArray) -> bool:
        """Take in one measured position, shape (n_joints,), and return whether the arm is at rest by now."""
        positions, reference, most = position_rad.tolist(), self._reference_rad, self._distance_rad
        # In the control loop: so few numbers are compared faster one by one than as arrays.
        went_back = time_ns < self._since_ns  # how long the arm has been where it is, nobody knows then
        if (
            reference is None
            or went_back
            or any(not -most <= q - before <= most for q, before in zip(positions, reference, strict=True))
        ):
            self._reference_rad, self._since_ns = positions, time_ns
        return time_ns - self._since_ns >= self._window_ns
