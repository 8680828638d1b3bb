"""The desired trajectory y: positions, velocities and accelerations over time, and how a path gets them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tel_ros.core.errors import TrajectoryError, counted
from tel_ros.core.trajectories.paths import Path
from tel_ros.core.trajectories.timing import MinimumJerk, Timing
from tel_ros.core.types import NS_PER_S, FloatArray, IntArray


@dataclass(frozen=True)
class DesiredTrajectory:
    """Joint positions, velocities and accelerations of shape (n, n_joints) at n >= 2 times.

    Raises:
        TrajectoryError: shapes disagree, a value is not finite, or time does not start at 0 and increase.
    """

    time_ns: IntArray
    position_rad: FloatArray
    velocity_rad_s: FloatArray
    acceleration_rad_s2: FloatArray

    def __post_init__(self) -> None:
        time_ns = self.time_ns
        if len(time_ns) < 2:
            raise TrajectoryError(f"the trajectory has {counted(len(time_ns), 'point')}; expected at least 2")
        if time_ns[0] != 0:
            raise TrajectoryError(f"the trajectory starts at {time_ns[0] / NS_PER_S} s; expected 0")
        steps = np.diff(time_ns)
        if np.any(steps <= 0):
            k = int(np.argmax(steps <= 0))
            raise TrajectoryError(
                f"time goes from {time_ns[k] / NS_PER_S} s to {time_ns[k + 1] / NS_PER_S} s "
                f"at point {k + 1}; expected strictly increasing times"
            )
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


def check_points(name: str, values: FloatArray, shape: tuple[int, int]) -> None:
    """Raise :class:`TrajectoryError` unless values have the shape and are finite."""
    if values.shape != shape or shape[1] == 0:
        raise TrajectoryError(f"{name} has shape {values.shape}; expected {shape} (points, joints)")
    if not np.all(np.isfinite(values)):
        k, joint = np.argwhere(~np.isfinite(values))[0]
        raise TrajectoryError(
            f"{name} is {values[k, joint]} for joint {joint + 1} at point {k}; expected finite numbers"
        )


def sample(path: Path, timing: Timing | float, rate_hz: float) -> DesiredTrajectory:
    """Run along a path from rest to rest with a timing, with ``rate_hz`` points a second.

    A number is the duration in s of a minimum-jerk timing. The last point is at the first tick that is not
    earlier than the end. Derivatives are exact.
    """
    timing = MinimumJerk(timing) if isinstance(timing, int | float) else timing
    n_steps = max(1, math.ceil(timing.duration_s * rate_hz - 1e-9))
    time_ns = np.round(np.arange(n_steps + 1) * (NS_PER_S / rate_hz)).astype(np.int64)
    s, ds, dds = timing.at(time_ns)
    q, dq, ddq = path.evaluate(s)
    rate, rate_of_rate = ds[:, None], dds[:, None]
    return DesiredTrajectory(
        time_ns=time_ns,
        position_rad=q,
        velocity_rad_s=dq * rate,
        acceleration_rad_s2=ddq * rate**2 + dq * rate_of_rate,
    )
