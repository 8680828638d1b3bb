"""Keeping score of one trial."""

from __future__ import annotations

import numpy as np

from tel_ros.core.types import BoolArray, FloatArray


class TrackingScore:
    """Tracking error, effort and saturation over the ticks of RUN."""

    def __init__(self, n_joints: int) -> None:
        self.ticks = 0
        self._largest_rad = np.zeros(n_joints)
        self.max_effort_nm = np.zeros(n_joints)
        self._squares = np.zeros(n_joints)
        self._saturated = 0

    def add(self, error_rad: FloatArray, effort_nm: FloatArray, saturated: BoolArray) -> None:
        """Take in one tick. Shapes (n_joints,)."""
        self.ticks += 1
        self._squares += error_rad * error_rad
        self._largest_rad = np.maximum(self._largest_rad, np.abs(error_rad))
        self.max_effort_nm = np.maximum(self.max_effort_nm, np.abs(effort_nm))
        self._saturated += bool(saturated.any())

    @property
    def rms_error_per_joint_rad(self) -> FloatArray:
        """Root mean square error of each joint, NaN before the first tick. Shape (n_joints,)."""
        if self.ticks == 0:
            return np.full_like(self._squares, np.nan)
        return np.sqrt(self._squares / self.ticks)

    @property
    def rms_error_rad(self) -> float:
        """Root mean square error over all joints and ticks, NaN before the first tick."""
        return float(np.sqrt(np.mean(self.rms_error_per_joint_rad**2)))

    @property
    def max_error_rad(self) -> float:
        """Largest deviation of any joint, NaN before the first tick."""
        return float(self._largest_rad.max()) if self.ticks else float("nan")

    @property
    def saturated_ratio(self) -> float:
        """Share of the ticks in which the effort of some joint had to be clipped, NaN before the first."""
        return self._saturated / self.ticks if self.ticks else float("nan")
