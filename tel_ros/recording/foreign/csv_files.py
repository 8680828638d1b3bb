"""Joint recordings and movements from CSV with named columns.

``time_s``, and for each joint ``q_<joint>`` [rad], ``dq_<joint>`` [rad/s], ``ddq_<joint>`` [rad/s²] and
``tau_<joint>`` [N·m], in any order. Only the columns that are asked for are read: others may hold anything.

Separators are commas, semicolons or tabs; numbers have decimal points and may stand in quotes. Empty lines
and those that begin with ``#`` are passed over; the header may be such a line.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tel_ros.core.errors import ConfigError, InputFileError, counted
from tel_ros.core.learning.inputs import stack_inputs
from tel_ros.core.learning.joint_recording import JointRecording
from tel_ros.core.learning.torque_samples import FEWEST_OF_SPLINE, motion
from tel_ros.core.trajectories.paths import waypoint_path
from tel_ros.core.trajectories.trajectory import sample
from tel_ros.core.types import FloatArray
from tel_ros.recording.foreign.renaming import Renaming, advice
from tel_ros.recording.shared_files import missing
from tel_ros.recording.waypoint_file import read_waypoints

TIME = "time_s"
POSITION, VELOCITY, ACCELERATION, TORQUE = "q_", "dq_", "ddq_", "tau_"
_RECORDING = f"a CSV with the columns {TIME}, {POSITION}<joint> and {TORQUE}<joint>"
_MOVEMENT = f"a CSV with the columns {TIME} and {POSITION}<joint>, or of waypoints"


@dataclass(frozen=True)
class Table:
    """A file of named columns: the cells of each row, and the lines on which they stand."""

    file: Path
    header: tuple[str, ...]
    rows: list[list[str]]
    lines: list[int]

    def named(self, prefix: str) -> tuple[str, ...]:
        """Return the joints that have a column with such a prefix."""
        return tuple(name.removeprefix(prefix) for name in self.header if name.startswith(prefix))

    def columns(self, prefix: str, joints: Sequence[str]) -> FloatArray:
        """Return a column a joint; InputFileError if one is missing or holds what is no finite number."""
        missing = [prefix + joint for joint in joints if prefix + joint not in self.header]
        if missing:
            found = f"has no column {', '.join(missing)}"
            how = advice(self.named(prefix or POSITION), joints)
            raise InputFileError(self.file, found, f"columns among {', '.join(self.header)}{how}")
        return np.array([self._column(prefix + joint) for joint in joints]).T.reshape(-1, len(joints))

    def times(self, may_repeat: bool) -> FloatArray:
        """Return the times; InputFileError if they go back, or repeat and may not."""
        time_s = self._column(TIME)
        step_s = np.diff(time_s)
        wrong = np.flatnonzero(step_s < 0.0 if may_repeat else step_s <= 0.0)
        if len(wrong):
            k = int(wrong[0]) + 1
            found = f"line {self.lines[k]}: {TIME} is {time_s[k]:g} after {time_s[k - 1]:g}"
            expected = "rows in the order of time" if may_repeat else "times that increase"
            raise InputFileError(self.file, found, expected)
        return time_s

    def _column(self, name: str) -> FloatArray:
        if self.header.count(name) > 1:
            raise InputFileError(self.file, f"has {name} twice", "each column once")
        place, values = self.header.index(name), np.empty(len(self.rows))
        for k, row in enumerate(self.rows):
            text = row[place].strip() if place < len(row) else ""
            try:
                values[k] = float(text)
            except ValueError:
                values[k] = math.nan
            if not math.isfinite(values[k]):
                found = f"line {self.lines[k]}: {name} is {text!r}"
                comma = re.fullmatch(r"[-+]?\d+,\d+([eE][-+]?\d+)?", text)
                raise InputFileError(
                    self.file, found, "a decimal point, not a comma" if comma else "a finite number"
                )
        return values


def read_table(file: Path, renaming: Renaming = str, expected: str = _RECORDING) -> Table:
    """Read a CSV with a header line; InputFileError if it is missing or malformed."""
    try:
        content = file.read_bytes()
        # Old programs' signs for degrees and the like stand in columns that nobody asks for.
        encoding = "utf-8-sig" if b"\0" in content or _can(bytes.decode, content) else "latin-1"
        if content[:2] in (b"\xff\xfe", b"\xfe\xff"):
            encoding = "utf-16"
        lines = content.decode(encoding).removeprefix("\ufeff").splitlines(keepends=True)
    except (OSError, ValueError) as error:  # ValueError: what is no text
        found = f"not readable ({error})" if file.is_file() else missing(file)
        raise InputFileError(file, found, expected) from error
    first = next((line for line in lines if line.strip() and not line.lstrip().startswith("#")), "")
    reader = csv.reader(lines, delimiter=max(";\t,", key=first.count), skipinitialspace=True)
    header, comment, rows, numbers = list[str](), list[str](), list[list[str]](), list[int]()
    try:
        for cells in reader:
            if not any(cells):
                continue
            if cells[0].lstrip().startswith("#"):
                comment = [cells[0].lstrip()[1:], *cells[1:]]
            elif header or (comment and all(_can(float, cell) for cell in cells if cell)):
                # As numpy.savetxt writes it: the header is the comment before the first row.
                header = header or comment
                rows.append(cells)
                numbers.append(reader.line_num)
            else:
                header = cells
    except csv.Error as error:
        raise InputFileError(file, f"line {reader.line_num} is not readable ({error})", expected) from error
    header = [name.strip() for name in header]
    while header and not header[-1]:  # a delimiter at the end of each line
        header.pop()
    if not rows:
        raise InputFileError(file, "has no rows", f"rows below the header of {expected}")
    for row, number in zip(rows, numbers, strict=True):
        if len(row) != len(header) and (len(row) < len(header) or any(row[len(header) :])):
            found = f"line {number} has {counted(len(row), 'value')}"
            more = ", with decimal points" if len(row) > len(header) else ""
            raise InputFileError(file, found, f"{len(header)}, as in its header{more}")
    return Table(file, tuple(_renamed(name, renaming) for name in header), rows, numbers)


def _renamed(column: str, renaming: Renaming) -> str:
    for prefix in (ACCELERATION, VELOCITY, POSITION, TORQUE):
        if column.startswith(prefix):
            return prefix + renaming(column.removeprefix(prefix))
    return column


def _can(convert: Callable[[Any], object], value: str | bytes) -> bool:
    try:
        convert(value)
        return True
    except ValueError:
        return False


def read_csv_recording(file: Path, joints: Sequence[str] = (), renaming: Renaming = str) -> JointRecording:
    """Read a recording of the joints to learn (empty: all with an effort), and of others.

    InputFileError: the file cannot be used or lacks a column of one of the joints to learn.
    """
    table = read_table(file, renaming)
    if TIME not in table.header or not table.named(POSITION):
        raise InputFileError(file, f"has the columns {', '.join(table.header)}", _RECORDING)
    if not (told := table.named(TORQUE)):
        found = f"tells no effort: it has the columns {', '.join(table.header)}"
        raise InputFileError(file, found, _RECORDING)
    for joint in joints:  # the effort first: that is what recordings lack
        table.columns(TORQUE, [joint])
    learned = joints or [joint for joint in table.named(POSITION) if joint in told]
    columns = dict[str, list[FloatArray]]()
    for joint in (*table.named(POSITION), *learned):
        try:
            position = table.columns(POSITION, [joint])
        except InputFileError:
            if joint in learned:
                raise
            continue  # nobody has asked for it
        unknown = np.full_like(position, np.nan)
        columns[joint] = [position, table.columns(TORQUE, [joint]) if joint in learned else unknown]
    time_s = table.times(may_repeat=True)
    positions, efforts = map(np.hstack, zip(*columns.values(), strict=True))
    return JointRecording(str(file), tuple(columns), time_s - time_s[0], positions, efforts)


def read_movement(
    file: Path,
    joints: tuple[str, ...],
    duration_s: float | None,
    rate_hz: float,
    renaming: Renaming = str,
) -> tuple[FloatArray, FloatArray]:
    """Read a movement: a CSV that tells times, or waypoints with a duration and a rate.

    Returns:
        Times [s] of shape (n,), and q, q̇, q̈ of shape (n, 3 * n_joints). Velocities and accelerations that
        the file does not tell are those of a spline through the positions.

    Raises InputFileError about the file; ConfigError: waypoints without a duration, or times with one.
    """
    table = read_table(file, renaming, _MOVEMENT)
    if TIME not in table.header:
        if duration_s is None or not 0.0 < duration_s < np.inf:
            expected = f"a time in s for the movement along the waypoints of {file} (it has no column {TIME})"
            raise ConfigError("--duration-s", "" if duration_s is None else duration_s, expected)
        path = waypoint_path(file.stem, read_waypoints(file, joints, "TRAJECTORY"))
        desired = sample(path, duration_s, rate_hz)
        inputs = stack_inputs(desired.position_rad, desired.velocity_rad_s, desired.acceleration_rad_s2)
        return desired.time_s, inputs
    if duration_s is not None:
        raise ConfigError("--duration-s", duration_s, f"nothing, because {file} tells times")
    time_s = table.times(may_repeat=False)
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
