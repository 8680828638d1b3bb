"""Keeping score of one trial."""

from __future__ import annotations

import numpy as np

from tel_ros.core.types import BoolArray, FloatArray


class TrackingScore:
    """Tracking error, effort and saturation over the ticks of RUN."""

    def __init__(self, n_joints: int) -> None:
        self.ticks = 0
        # Lists: in the control loop so few numbers are faster one by one than as arrays.
        self._largest_rad = [0.0] * n_joints
        self._largest_nm = [0.0] * n_joints
        self._squares = [0.0] * n_joints
        self._saturated = 0

    def add(self, error_rad: FloatArray, effort_nm: FloatArray, saturated: BoolArray) -> None:
        """Take in one tick. Shapes (n_joints,)."""
        self.ticks += 1
        for j, (error, effort) in enumerate(zip(error_rad.tolist(), effort_nm.tolist(), strict=True)):
            self._squares[j] += error * error
            self._largest_rad[j] = max(self._largest_rad[j], abs(error))
            self._largest_nm[j] = max(self._largest_nm[j], abs(effort))
        self._saturated += any(saturated.tolist())

    @property
    def max_effort_nm(self) -> FloatArray:
        """Largest effort of each joint so far. Shape (n_joints,)."""
        return np.array(self._largest_nm)

    @property
    def rms_error_per_joint_rad(self) -> FloatArray:
        """Root mean square error of each joint, NaN before the first tick. Shape (n_joints,)."""
        if self.ticks == 0:
            return np.full(len(self._squares), np.nan)
        return np.sqrt(np.array(self._squares) / self.ticks)

    @property
    def rms_error_rad(self) -> float:
        """Root mean square error over all joints and ticks, NaN before the first tick."""
        return float(np.sqrt(np.mean(self.rms_error_per_joint_rad**2)))

    @property
    def max_error_rad(self) -> float:
        """Largest deviation of any joint, NaN before the first tick."""
        return max(self._largest_rad) if self.ticks else float("nan")

    @property
    def saturated_ratio(self) -> float:
        """Share of the ticks in which the effort of some joint had to be clipped, NaN before the first."""
        return self._saturated / self.ticks if self.ticks else float("nan")
