"""Reading a path from a CSV of waypoints."""

from __future__ import annotations

import csv
import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from tel_ros.core.config import ArmConfig, PathConfig
from tel_ros.core.errors import InputFileError, counted
from tel_ros.core.trajectories.paths import NAMED_PATHS, named_path, waypoint_path
from tel_ros.core.trajectories.paths import Path as JointPath
from tel_ros.core.types import FloatArray
from tel_ros.recording.shared_files import missing


def load_path(path: PathConfig, arm: ArmConfig) -> JointPath:
    """Return the configured path, built in (ConfigError if there is none) or from a file (InputFileError).

    Of several, the first, which has all of them beside it.
    """
    if path.files:
        several = [
            _load(file if file in NAMED_PATHS else "", file, "path.", arm, "files") for file in path.files
        ]
        return replace(several[0], library=tuple(several))
    return _load(path.name, path.file, "path.", arm)


def load_known_path(path: PathConfig, arm: ArmConfig) -> JointPath | None:
    """Return the path that practice with a varied shape begins with, or None; errors as :func:`load_path`."""
    if not (path.known_name or path.known_file):
        return None
    return _load(path.known_name, path.known_file, "path.known_", arm)


def _load(name: str, file: str, keys: str, arm: ArmConfig, listed: str = "") -> JointPath:
    if name:
        return named_path(name, len(arm.joints), keys + (listed or "name"))
    return waypoint_path(Path(file).stem, read_waypoints(Path(file), arm.joints, keys + (listed or "file")))


def read_waypoints(file: Path, joints: tuple[str, ...], key: str = "path.file") -> FloatArray:
    """Read waypoints: a header line with the joints' names in any order, then one row a waypoint, in rad.

    ``key``: of the configuration, for messages. Columns are in the order of ``joints``. InputFileError: it is
    no such file, or has fewer than two waypoints or two equal neighbours.
    """
    try:
        with file.open(newline="", encoding="utf-8-sig") as lines:
            rows = [(number, row) for number, row in enumerate(csv.reader(lines), start=1) if row]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        found = f"not readable ({error})" if file.is_file() else missing(file)
        raise InputFileError(file, found, f"a CSV of waypoints (key {key})") from error
    header = [name.strip() for name in rows[0][1]] if rows else []
    if sorted(header) != sorted(joints):
        raise InputFileError(
            file, f"line 1 is {', '.join(header) or 'empty'}", f"the names of the joints: {', '.join(joints)}"
        )
    waypoints = np.empty((len(rows) - 1, len(joints)))
    for k, (number, row) in enumerate(rows[1:]):
        if len(row) != len(joints):
            raise InputFileError(file, f"line {number} has {counted(len(row), 'value')}", f"{len(joints)}")
        for name, text in zip(header, row, strict=True):
            waypoints[k, joints.index(name)] = _finite(text, file, number, name)
    if len(waypoints) < 2:
        raise InputFileError(file, f"holds {counted(len(waypoints), 'waypoint')}", "at least 2")
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
