"""Paths: the shape of a movement in joint space, without any timing."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import pi

import numpy as np
from scipy.interpolate import CubicSpline

from tel_ros.core.errors import ConfigError
from tel_ros.core.types import FloatArray

Derivatives = tuple[FloatArray, FloatArray, FloatArray]


@dataclass(frozen=True)
class Path:
    """A curve in joint space.

    Args:
        name: for records and messages.
        n_joints: number of joint angles that it gives.
        evaluate: from s of shape (n,), 0 at the start and 1 at the end, to q [rad], dq/ds and d²q/ds²,
            each of shape (n, n_joints).
    """

    name: str
    n_joints: int
    evaluate: Callable[[FloatArray], Derivatives]


def _planar_loops(s: FloatArray) -> Derivatives:
    # Harmonics of 2π s: (joint, amplitude, multiple of 2π, phase); a cosine is a sine a quarter turn ahead.
    terms = [
        (0, 0.45, 2, 0.0),
        (0, 0.20, 3, 0.0),
        (1, 0.50, 3, 0.0),
        (1, 0.25, 2, pi / 2),
    ]
    q = np.tile([0.6, 1.3 - 0.25], (len(s), 1))
    dq, ddq = np.zeros_like(q), np.zeros_like(q)
    for joint, amplitude, multiple, phase in terms:
        omega = 2.0 * pi * multiple
        q[:, joint] += amplitude * np.sin(omega * s + phase)
        dq[:, joint] += amplitude * omega * np.cos(omega * s + phase)
        ddq[:, joint] -= amplitude * omega**2 * np.sin(omega * s + phase)
    return q, dq, ddq


NAMED_PATHS = {
    "planar_loops": Path("planar_loops", 2, _planar_loops),
}
"""Built-in paths. ``planar_loops`` is ours: q1 = 0.6 + 0.45 sin 4πs + 0.2 sin 6πs,
q2 = 1.3 + 0.5 sin 6πs + 0.25 (cos 4πs - 1), a closed figure for a two-joint arm."""


def named_path(name: str, n_joints: int) -> Path:
    """Return a built-in path.

    Raises:
        ConfigError: there is no such path, or it is for another number of joints.
    """
    if name not in NAMED_PATHS:
        raise ConfigError("path.name", name, f"one of {', '.join(sorted(NAMED_PATHS))}")
    path = NAMED_PATHS[name]
    if path.n_joints != n_joints:
        raise ConfigError(
            "path.name", name, f"a path for {n_joints} joints (this one is for {path.n_joints})"
        )
    return path


def waypoint_path(name: str, waypoints_rad: FloatArray) -> Path:
    """Return a smooth path through waypoints: a cubic spline over the distance in joint space.

    The spline is closed smoothly if the last waypoint equals the first, otherwise its ends are natural.

    Args:
        name: for records and messages.
        waypoints_rad: shape (n, n_joints), n >= 2, finite, no two neighbours equal.
    """
    chord = np.linalg.norm(np.diff(waypoints_rad, axis=0), axis=1)
    s_knots = np.concatenate([[0.0], np.cumsum(chord)]) / chord.sum()
    closed = len(waypoints_rad) > 2 and bool(np.array_equal(waypoints_rad[0], waypoints_rad[-1]))
    spline = CubicSpline(s_knots, waypoints_rad, bc_type="periodic" if closed else "natural")

    def evaluate(s: FloatArray) -> Derivatives:
        return spline(s), spline(s, 1), spline(s, 2)

    return Path(name, waypoints_rad.shape[1], evaluate)
