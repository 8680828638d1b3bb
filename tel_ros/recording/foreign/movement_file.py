"""Movements that torques are wanted for, from CSV."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tel_ros.core.errors import ConfigError, InputFileError
from tel_ros.core.learning.inputs import stack_inputs
from tel_ros.core.learning.torque_samples import FEWEST_OF_SPLINE, motion
from tel_ros.core.trajectories.paths import waypoint_path
from tel_ros.core.trajectories.trajectory import sample
from tel_ros.core.types import FloatArray
from tel_ros.recording.foreign.csv_source import ACCELERATION, POSITION, TIME, VELOCITY, read_table
from tel_ros.recording.waypoint_file import read_waypoints


def read_movement(
    file: Path, joints: tuple[str, ...], duration_s: float | None, rate_hz: float
) -> tuple[FloatArray, FloatArray]:
    """Read a movement.

    Args:
        file: a CSV with ``time_s`` and ``q_<joint>``, with or without ``dq_<joint>`` and ``ddq_<joint>``; or
            waypoints, a column a joint, as practice takes them.
        joints: names, in the order of the columns that are returned.
        duration_s: of the movement along waypoints; None for a file that tells times.
        rate_hz: of the points along waypoints.

    Returns:
        Times [s] of shape (n,), and q, q̇, q̈ of shape (n, 3 * n_joints). Velocities and accelerations that
        the file does not tell are those of a spline through the positions.

    Raises:
        InputFileError: the file is missing or malformed, lacks a joint, tells too few points, or times that
            do not increase.
        ConfigError: waypoints without a duration, or times with one.
    """
    table = read_table(file)
    if TIME not in table.header:
        if duration_s is None or not 0.0 < duration_s < np.inf:
            expected = f"a time in s for the movement along the waypoints of {file} (it has no column {TIME})"
            raise ConfigError("--duration-s", duration_s, expected)
        path = waypoint_path(file.stem, read_waypoints(file, joints, "TRAJECTORY"))
        desired = sample(path, duration_s, rate_hz)
        inputs = stack_inputs(desired.position_rad, desired.velocity_rad_s, desired.acceleration_rad_s2)
        return desired.time_s, inputs
    if duration_s is not None:
        raise ConfigError("--duration-s", duration_s, f"nothing, because {file} tells times")
    time_s = table.columns("", [TIME])[:, 0]
    wrong = np.flatnonzero(np.diff(time_s) <= 0.0)
    if len(wrong):
        found = f"the time of row {wrong[0] + 2} is {time_s[wrong[0] + 1]:g} s after {time_s[wrong[0]]:g} s"
        raise InputFileError(file, found, "times that increase")
    position = table.columns(POSITION, joints)
    velocity, acceleration = (
        table.columns(prefix, joints) if any(prefix + joint in table.header for joint in joints) else None
        for prefix in (VELOCITY, ACCELERATION)
    )
    if velocity is None or acceleration is None:
        if len(time_s) < FEWEST_OF_SPLINE:
            found = f"has {len(time_s)} points without velocities and accelerations"
            raise InputFileError(file, found, f"at least {FEWEST_OF_SPLINE}, or the columns dq_… and ddq_…")
        _, slope, curvature = np.split(motion(time_s, position), 3, axis=1)
        velocity = slope if velocity is None else velocity
        acceleration = curvature if acceleration is None else acceleration
    return time_s, stack_inputs(position, velocity, acceleration)
