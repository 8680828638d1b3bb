"""Paths on the way to the one that is wanted: smaller, nearer to a known one, or only a part of it."""

from __future__ import annotations

from tel_ros.core.trajectories.paths import Derivatives, Path
from tel_ros.core.types import FloatArray


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
