"""Joint recordings and movements from CSV with named columns.

``time_s``, and for each joint ``q_<joint>`` [rad], ``dq_<joint>`` [rad/s], ``ddq_<joint>`` [rad/s²] and
``tau_<joint>`` [N·m], in any order. Other columns are passed over.
"""

from __future__ import annotations

import csv
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tel_ros.core.errors import ConfigError, InputFileError, counted
from tel_ros.core.learning.inputs import stack_inputs
from tel_ros.core.learning.joint_recording import JointRecording
from tel_ros.core.learning.torque_samples import FEWEST_OF_SPLINE, motion
from tel_ros.core.trajectories.paths import waypoint_path
from tel_ros.core.trajectories.trajectory import sample
from tel_ros.core.types import FloatArray
from tel_ros.recording.shared_files import missing
from tel_ros.recording.waypoint_file import read_waypoints

TIME = "time_s"
POSITION, VELOCITY, ACCELERATION, TORQUE = "q_", "dq_", "ddq_", "tau_"
_COLUMNS = f"the columns {TIME}, {POSITION}<joint> and {TORQUE}<joint>"


@dataclass(frozen=True)
class Table:
    """A file of named columns; ``values`` has the shape (n, n_columns)."""

    file: Path
    header: tuple[str, ...]
    values: FloatArray

    def named(self, prefix: str) -> tuple[str, ...]:
        """Return the joints that have a column with such a prefix."""
        return tuple(name.removeprefix(prefix) for name in self.header if name.startswith(prefix))

    def columns(self, prefix: str, joints: Sequence[str]) -> FloatArray:
        """Return a column a joint; InputFileError if one is missing or holds what is no finite number."""
        missing = [prefix + joint for joint in joints if prefix + joint not in self.header]
        if missing:
            found = f"has no column {', '.join(missing)}"
            raise InputFileError(self.file, found, f"columns among {', '.join(self.header)}")
        found_columns = self.values[:, [self.header.index(prefix + joint) for joint in joints]]
        bad = np.argwhere(~np.isfinite(found_columns))
        if len(bad):
            row, column = bad[0]
            found = f"{prefix}{joints[column]} is {found_columns[row, column]} in row {row + 1}"
            raise InputFileError(self.file, found, "finite numbers")
        return found_columns


def read_table(file: Path) -> Table:
    """Read a CSV of numbers with a header line; InputFileError if it is missing or malformed."""
    try:
        with file.open(newline="", encoding="utf-8-sig") as lines:
            header = tuple(name.strip() for name in next(csv.reader(lines), []))
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", UserWarning)  # that there is no row, which is told below
                values = np.loadtxt(lines, delimiter=",", ndmin=2)
    except (OSError, ValueError, csv.Error) as error:  # ValueError: also what is no UTF-8
        found = f"not readable ({error})" if file.is_file() else missing(file)
        raise InputFileError(file, found, f"a CSV with {_COLUMNS}") from error
    repeated = sorted({name for name in header if header.count(name) > 1})
    if repeated:
        raise InputFileError(file, f"has {', '.join(repeated)} twice", "each column once")
    if not values.size:
        raise InputFileError(file, "has no rows", f"rows under {_COLUMNS}")
    if values.shape[1] != len(header):
        found = f"has {counted(values.shape[1], 'value')} a row"
        raise InputFileError(file, found, f"{len(header)}, as its header")
    return Table(file, header, values)


def read_csv_recording(file: Path, joints: Sequence[str] = ()) -> JointRecording:
    """Read a recording of all joints that have a position; efforts are NaN without a ``tau_`` column.

    Raises InputFileError if the file cannot be used or lacks the efforts of one of ``joints``.
    """
    table = read_table(file)
    if TIME not in table.header or not table.named(POSITION):
        raise InputFileError(file, f"has the columns {', '.join(table.header)}", _COLUMNS)
    told = table.named(TORQUE)
    if not told:
        raise InputFileError(file, f"tells no effort: it has the columns {', '.join(table.header)}", _COLUMNS)
    for joint in joints:
        table.columns(TORQUE, [joint])
    names = table.named(POSITION)
    efforts = np.full((len(table.values), len(names)), np.nan)
    for j, joint in enumerate(names):
        if joint in told:
            efforts[:, j] = table.columns(TORQUE, [joint])[:, 0]
    time_s = table.columns("", [TIME])[:, 0]
    return JointRecording(str(file), names, time_s - time_s[0], table.columns(POSITION, names), efforts)


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
            found = f"has {counted(len(time_s), 'point')} without velocities and accelerations"
            raise InputFileError(file, found, f"at least {FEWEST_OF_SPLINE}, or the columns dq_… and ddq_…")
        _, slope, curvature = np.split(motion(time_s, position), 3, axis=1)
        velocity = slope if velocity is None else velocity
        acceleration = curvature if acceleration is None else acceleration
    return time_s, stack_inputs(position, velocity, acceleration)
