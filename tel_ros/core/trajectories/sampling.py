"""From a path and a duration to a desired trajectory."""

from __future__ import annotations

import math

import numpy as np

from tel_ros.core.trajectories.paths import Path
from tel_ros.core.trajectories.time_scaling import minimum_jerk
from tel_ros.core.trajectories.trajectory import DesiredTrajectory
from tel_ros.core.types import NS_PER_S


def sample(path: Path, duration_s: float, rate_hz: float) -> DesiredTrajectory:
    """Run along a path from rest to rest in the given time.

    Args:
        path: shape of the movement.
        duration_s: how long it takes; the last point is at the first tick that is not earlier.
        rate_hz: points a second.

    Returns:
        The desired trajectory, with exact derivatives.
    """
    n_steps = max(1, math.ceil(duration_s * rate_hz - 1e-9))
    time_ns = np.round(np.arange(n_steps + 1) * (NS_PER_S / rate_hz)).astype(np.int64)
    s, ds, dds = minimum_jerk(time_ns / (NS_PER_S * duration_s))
    q, dq, ddq = path.evaluate(s)
    rate, rate_of_rate = (ds / duration_s)[:, None], (dds / duration_s**2)[:, None]
    return DesiredTrajectory(
        time_ns=time_ns,
        position_rad=q,
        velocity_rad_s=dq * rate,
        acceleration_rad_s2=ddq * rate**2 + dq * rate_of_rate,
    )
