"""The desired trajectory y: where the joints should be, how fast, and with which acceleration."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tel_ros.core.errors import TrajectoryError
from tel_ros.core.types import NS_PER_S, FloatArray, IntArray


@dataclass(frozen=True)
class DesiredTrajectory:
    """Joint positions, velocities and accelerations over time.

    Args:
        time_ns: times of the points, from 0, strictly increasing. Shape (n,), n >= 2.
        position_rad: shape (n, n_joints).
        velocity_rad_s: shape (n, n_joints).
        acceleration_rad_s2: shape (n, n_joints).

    Raises:
        TrajectoryError: shapes disagree, a value is not finite, or time does not start at 0 and increase.
    """

    time_ns: IntArray
    position_rad: FloatArray
    velocity_rad_s: FloatArray
    acceleration_rad_s2: FloatArray

    def __post_init__(self) -> None:
        check_times(self.time_ns)
        for name in ("position_rad", "velocity_rad_s", "acceleration_rad_s2"):
            check_points(name, getattr(self, name), (len(self.time_ns), self.n_joints))

    @property
    def n_joints(self) -> int:
        """Number of joints."""
        return self.position_rad.shape[1] if self.position_rad.ndim == 2 else 0

    @property
    def duration_s(self) -> float:
        """Time of the last point."""
        return float(self.time_ns[-1]) / NS_PER_S

    @property
    def time_s(self) -> FloatArray:
        """Times in seconds. Shape (n,)."""
        return self.time_ns / NS_PER_S


def check_times(time_ns: IntArray) -> None:
    """Raise :class:`TrajectoryError` unless times start at 0 and strictly increase."""
    if len(time_ns) < 2:
        raise TrajectoryError(f"the trajectory has {len(time_ns)} points; expected at least 2")
    if time_ns[0] != 0:
        raise TrajectoryError(f"the trajectory starts at {time_ns[0] / NS_PER_S} s; expected 0")
    steps = np.diff(time_ns)
    if np.any(steps <= 0):
        k = int(np.argmax(steps <= 0))
        raise TrajectoryError(
            f"time goes from {time_ns[k] / NS_PER_S} s to {time_ns[k + 1] / NS_PER_S} s "
            f"at point {k + 1}; expected strictly increasing times"
        )


def check_points(name: str, values: FloatArray, shape: tuple[int, int]) -> None:
    """Raise :class:`TrajectoryError` unless values have the shape and are finite."""
    if values.shape != shape or shape[1] == 0:
        raise TrajectoryError(f"{name} has shape {values.shape}; expected {shape} (points, joints)")
    if not np.all(np.isfinite(values)):
        k, joint = np.argwhere(~np.isfinite(values))[0]
        raise TrajectoryError(
            f"{name} is {values[k, joint]} for joint {joint + 1} at point {k}; expected finite numbers"
        )
