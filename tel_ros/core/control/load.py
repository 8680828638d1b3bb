"""What the springs had to exert to hold an arm at rest."""

from __future__ import annotations

import math

import numpy as np

from tel_ros.core.types import NS_PER_S, FloatArray

SMOOTHING_S = 0.3
LEAST_DEFLECTION_RAD = 0.01


class HoldingLoad:
    """Remembers the effort that held the arm when it was last at rest: gravity, as far as springs know it.

    Efforts are smoothed over 0.3 s, so that sensor noise in the damping does not count.
    """

    def __init__(self) -> None:
        self._smooth_nm: list[float] | None = None
        self._last_ns = 0
        self.effort_nm: FloatArray | None = None
        """Shape (n_joints,); None: it has not been at rest under these springs."""

    def add(self, time_ns: int, effort_nm: FloatArray) -> None:
        """Take in one effort, shape (n_joints,)."""
        step_s = (time_ns - self._last_ns) / NS_PER_S
        efforts = effort_nm.tolist()
        if self._smooth_nm is None or step_s <= 0.0:
            self._smooth_nm = efforts
        else:
            share = -math.expm1(-step_s / SMOOTHING_S)
            self._smooth_nm = [
                smooth + share * (effort - smooth)
                for smooth, effort in zip(self._smooth_nm, efforts, strict=True)
            ]
        self._last_ns = time_ns

    def keep(self) -> None:
        """Remember the present effort: the arm is at rest."""
        self.effort_nm = None if self._smooth_nm is None else np.array(self._smooth_nm)

    def lose(self, stiffness_nm_per_rad: FloatArray) -> None:
        """Forget a load: nobody holds the arm where it was held. That there is none stays known."""
        deflection = self.deflection_rad(stiffness_nm_per_rad)
        if deflection is None or deflection.any():
            self.effort_nm = None

    def deflection_rad(self, stiffness_nm_per_rad: FloatArray) -> FloatArray | None:
        """Return by how much springs are deflected under the load, shape (n_joints,), None if unknown.

        An arm with less than 0.01 rad at every joint counts as bearing none: that much is what friction and
        the last of a motion leave.
        """
        if self.effort_nm is None:
            return None
        deflection: FloatArray = self.effort_nm / stiffness_nm_per_rad
        return deflection if np.abs(deflection).max() > LEAST_DEFLECTION_RAD else np.zeros_like(deflection)
