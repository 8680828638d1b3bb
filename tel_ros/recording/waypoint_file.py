"""Reading a path from a CSV of waypoints."""

from __future__ import annotations

import csv
import math
from pathlib import Path

import numpy as np

from tel_ros.core.config import ArmConfig, PathConfig
from tel_ros.core.errors import ConfigError, InputFileError
from tel_ros.core.trajectories.paths import Path as JointPath
from tel_ros.core.trajectories.paths import named_path, waypoint_path
from tel_ros.core.types import FloatArray


def load_path(path: PathConfig, arm: ArmConfig) -> JointPath:
    """Return the configured path, built in or from a file.

    Raises:
        ConfigError: there is no built-in path of that name for that number of joints.
        InputFileError: the file is missing or malformed.
    """
    if path.name:
        return named_path(path.name, len(arm.joints))
    file = Path(path.file)
    return waypoint_path(file.stem, read_waypoints(file, arm.joints))


def load_known_path(path: PathConfig, arm: ArmConfig) -> JointPath | None:
    """Return the path that practice begins with where the shape is varied; None if there is none.

    Raises:
        ConfigError, InputFileError: as :func:`load_path`.
    """
    if path.known_name:
        try:
            return named_path(path.known_name, len(arm.joints))
        except ConfigError as error:
            raise ConfigError("path.known_name", error.value, error.expected) from None
    if path.known_file:
        file = Path(path.known_file)
        return waypoint_path(file.stem, read_waypoints(file, arm.joints, "path.known_file"))
    return None


def read_waypoints(file: Path, joints: tuple[str, ...], key: str = "path.file") -> FloatArray:
    """Read waypoints: a header line with the joints' names in any order, then one row a waypoint, in rad.

    Args:
        file: to read.
        joints: names, in the order of the columns that are returned.
        key: of the configuration, for messages.

    Returns:
        Shape (n, n_joints), columns in the order of ``joints``.

    Raises:
        InputFileError: the file is missing, a column is missing or unknown, a row has the wrong length or a
            value that is no finite number, there are fewer than two waypoints or two equal neighbours.
    """
    try:
        with file.open(newline="", encoding="utf-8-sig") as lines:
            rows = [(number, row) for number, row in enumerate(csv.reader(lines), start=1) if row]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        reason = (
            "there is no such file" if isinstance(error, FileNotFoundError) else f"not readable ({error})"
        )
        raise InputFileError(file, reason, f"a CSV of waypoints (key {key})") from error
    header = [name.strip() for name in rows[0][1]] if rows else []
    if sorted(header) != sorted(joints):
        raise InputFileError(
            file, f"line 1 is {', '.join(header) or 'empty'}", f"the names of the joints: {', '.join(joints)}"
        )
    waypoints = np.empty((len(rows) - 1, len(joints)))
    for k, (number, row) in enumerate(rows[1:]):
        if len(row) != len(joints):
            raise InputFileError(file, f"line {number} has {len(row)} values", f"{len(joints)}")
        for name, text in zip(header, row, strict=True):
            waypoints[k, joints.index(name)] = _finite(text, file, number, name)
    if len(waypoints) < 2:
        raise InputFileError(file, f"holds {len(waypoints)} waypoints", "at least 2")
    standing = np.flatnonzero(np.all(np.diff(waypoints, axis=0) == 0.0, axis=1))
    if len(standing):
        number = rows[1 + int(standing[0]) + 1][0]
        raise InputFileError(file, f"line {number} repeats the waypoint before it", "waypoints that differ")
    return waypoints


def _finite(text: str, file: Path, number: int, name: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputFileError(file, f"line {number}: {name} is {text.strip()!r}", "a finite number in rad")
    return value
