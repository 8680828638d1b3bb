"""Paths: the shape of a movement in joint space, without any timing; whole, scaled, blended or in part."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import pi

import numpy as np

from tel_ros.core.errors import ConfigError, counted
from tel_ros.core.types import FloatArray

Derivatives = tuple[FloatArray, FloatArray, FloatArray]


@dataclass(frozen=True)
class Path:
    """A curve in joint space."""

    name: str
    n_joints: int
    evaluate: Callable[[FloatArray], Derivatives]
    """From s of shape (n,), 0 at the start and 1 at the end, to q [rad], dq/ds and d²q/ds², each of shape
    (n, n_joints)."""
    library: tuple[Path, ...] = ()
    """All paths that are practised, where they are several; this is the first of them."""

    def named(self, name: str) -> Path:
        """Return a path of the library; empty: this one."""
        return next(path for path in self.library if path.name == name) if name else self


@dataclass(frozen=True)
class _Sine:
    """amplitude_rad · sin(2π · cycles · s + phase_rad) in the position of one joint."""

    joint: int
    amplitude_rad: float
    cycles: int
    phase_rad: float = 0.0


def _sum_of_sines(name: str, centre_rad: tuple[float, ...], terms: tuple[_Sine, ...]) -> Path:
    """Return a closed path: each joint swings about its centre, with as many cycles as its terms say."""

    def evaluate(s: FloatArray) -> Derivatives:
        q = np.tile(centre_rad, (len(s), 1))
        dq, ddq = np.zeros_like(q), np.zeros_like(q)
        for term in terms:
            omega, amplitude, joint = 2.0 * pi * term.cycles, term.amplitude_rad, term.joint
            q[:, joint] += amplitude * np.sin(omega * s + term.phase_rad)
            dq[:, joint] += amplitude * omega * np.cos(omega * s + term.phase_rad)
            ddq[:, joint] -= amplitude * omega**2 * np.sin(omega * s + term.phase_rad)
        return q, dq, ddq

    return Path(name, len(centre_rad), evaluate)


def _loops(name: str, centre_rad: tuple[float, ...], amplitudes_rad: tuple[float, ...]) -> Path:
    """Return a closed path that all joints of an arm take part in, none in step with another.

    Joint j adds up one cycle and, half as wide, two cycles; its phases are those of joint 0 moved on by j
    equal parts of a turn, the faster ones the other way round.
    """
    part = 2.0 * pi / len(centre_rad)
    terms = tuple(
        term
        for j, amplitude in enumerate(amplitudes_rad)
        for term in (_Sine(j, amplitude * 2 / 3, 1, j * part), _Sine(j, amplitude / 3, 2, -j * part))
    )
    return _sum_of_sines(name, centre_rad, terms)


NAMED_PATHS = {
    path.name: path
    for path in (
        # A cosine is a sine a quarter turn ahead.
        _sum_of_sines(
            "planar_loops",
            (0.6, 1.3 - 0.25),
            (_Sine(0, 0.45, 2), _Sine(0, 0.20, 3), _Sine(1, 0.50, 3), _Sine(1, 0.25, 2, pi / 2)),
        ),
        _sum_of_sines(
            "planar_loops_3",
            (0.4, 0.9, 0.7),
            (
                _Sine(0, 0.40, 2),
                _Sine(0, 0.15, 3),
                _Sine(1, 0.40, 3),
                _Sine(1, 0.20, 2, pi / 2),
                _Sine(2, 0.35, 2, pi),
                _Sine(2, 0.25, 3, pi / 2),
            ),
        ),
        _loops("kuka_iiwa_loops", (0.0, 0.6, 0.0, -1.2, 0.0, 0.9, 0.0), (0.6,) * 7),
        _loops("franka_panda_loops", (0.0, 0.0, 0.0, -1.8, 0.0, 1.9, 0.8), (0.6,) * 7),
    )
}
"""Built-in paths, all ours, all closed. ``planar_loops``: q1 = 0.6 + 0.45 sin 4πs + 0.2 sin 6πs,
q2 = 1.3 + 0.5 sin 6πs + 0.25 (cos 4πs - 1), for a two-joint arm; ``planar_loops_3`` is like it, for three.
``kuka_iiwa_loops`` and ``franka_panda_loops`` move all seven joints by about 0.5 rad to either side of a
posture with a bent elbow and a free wrist."""


def named_path(name: str, n_joints: int, key: str = "path.name") -> Path:
    """Return a built-in path.

    Raises:
        ConfigError: there is no such path, or it is for another number of joints.
    """
    if name not in NAMED_PATHS:
        raise ConfigError(key, name, f"one of {', '.join(sorted(NAMED_PATHS))}")
    path = NAMED_PATHS[name]
    if path.n_joints != n_joints:
        expected = f"a path for {counted(n_joints, 'joint')} (this one is for {path.n_joints})"
        raise ConfigError(key, name, expected)
    return path


def waypoint_path(name: str, waypoints_rad: FloatArray) -> Path:
    """Return a smooth path through waypoints: a cubic spline over the distance in joint space.

    The spline is closed smoothly if the last waypoint equals the first, otherwise its ends are natural.
    Waypoints: shape (n, n_joints), n >= 2, finite, no two neighbours equal.
    """
    from scipy.interpolate import CubicSpline  # late: a second of every start-up, for this alone

    chord = np.linalg.norm(np.diff(waypoints_rad, axis=0), axis=1)
    s_knots = np.concatenate([[0.0], np.cumsum(chord)]) / chord.sum()
    closed = len(waypoints_rad) > 2 and bool(np.array_equal(waypoints_rad[0], waypoints_rad[-1]))
    spline = CubicSpline(s_knots, waypoints_rad, bc_type="periodic" if closed else "natural")

    def evaluate(s: FloatArray) -> Derivatives:
        return spline(s), spline(s, 1), spline(s, 2)

    return Path(name, waypoints_rad.shape[1], evaluate)


def scaled(path: Path, amplitude: float) -> Path:
    """Return a path that is drawn together towards its first posture."""

    def evaluate(s: FloatArray) -> Derivatives:
        q, dq, ddq = path.evaluate(s)
        first = path.evaluate(s[:1] * 0.0)[0]
        return first + amplitude * (q - first), amplitude * dq, amplitude * ddq

    return Path(path.name, path.n_joints, evaluate)


def blended(known: Path, path: Path, share: float) -> Path:
    """Return a path between a known one (share 0) and another (share 1)."""

    def evaluate(s: FloatArray) -> Derivatives:
        a, b = known.evaluate(s), path.evaluate(s)
        q, dq, ddq = ((1.0 - share) * x + share * y for x, y in zip(a, b, strict=True))
        return q, dq, ddq

    return Path(path.name, path.n_joints, evaluate)


def part(path: Path, start: float, end: float) -> Path:
    """Return the part of a path from s = ``start`` to s = ``end``, 0 <= start < end <= 1."""
    length = end - start

    def evaluate(s: FloatArray) -> Derivatives:
        q, dq, ddq = path.evaluate(start + length * s)
        return q, length * dq, length**2 * ddq

    return Path(path.name, path.n_joints, evaluate)
