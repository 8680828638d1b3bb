"""The efforts that a path takes, at any speed along it, from what a network predicts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from tel_ros.core.trajectories.paths import Path
from tel_ros.core.trajectories.timing import minimum_jerk
from tel_ros.core.trajectories.trajectory import DesiredTrajectory
from tel_ros.core.types import NS_PER_S, FloatArray

INTERVALS = 720
_PROBES_PER_S = (1.0 / 3.0, 2.0 / 3.0, 1.0)
"""Speeds along the path at which to ask, as shares of the highest one."""
_PROBE_STEP_NS = 1000 * NS_PER_S
"""Between two points of a probe: so long that what lies between them does not matter."""


def knots() -> FloatArray:
    """Return s at the ends of the intervals: dense towards both ends, where the arm is slow."""
    return minimum_jerk(np.linspace(0.0, 1.0, INTERVALS + 1))[0]


def middles() -> FloatArray:
    """Return s in the middle of each interval."""
    s = knots()
    return 0.5 * (s[:-1] + s[1:])


@dataclass(frozen=True)
class PathDynamics:
    """The efforts τ = a s̈ + b ṡ² + d ṡ + c that a path takes, at :func:`middles`. Shapes (n, n_joints)."""

    tangent_rad: FloatArray
    """dq/ds."""
    inertial: FloatArray
    """a [N·m s²]."""
    centrifugal: FloatArray
    """b [N·m s²]."""
    viscous: FloatArray
    """d [N·m s]."""
    static_nm: FloatArray
    """c: gravity, and dry friction in the direction of motion."""

    @staticmethod
    def probe(path: Path, top_speed_per_s: float) -> DesiredTrajectory:
        """Return a trajectory whose efforts tell all coefficients; no arm could follow it.

        At each s there are three speeds up to the highest, then the highest with an acceleration.
        """
        speeds = [share * top_speed_per_s for share in _PROBES_PER_S]
        q, dq, ddq = path.evaluate(middles())
        pairs = [(speed, 0.0) for speed in speeds] + [(speeds[-1], speeds[-1] ** 2)]
        return DesiredTrajectory(
            time_ns=np.arange(len(pairs) * len(q)) * _PROBE_STEP_NS,
            position_rad=np.vstack([q] * len(pairs)),
            velocity_rad_s=np.vstack([dq * ds for ds, _ in pairs]),
            acceleration_rad_s2=np.vstack([ddq * ds**2 + dq * dds for ds, dds in pairs]),
        )

    @classmethod
    def of(cls, path: Path, top_speed_per_s: float, effort_nm: FloatArray) -> Self:
        """Return the dynamics from the efforts that :meth:`probe` takes. Shape (its points, n_joints)."""
        top = top_speed_per_s
        slow, middle, fast, pushed = effort_nm.reshape(4, INTERVALS, -1)
        # A parabola through three equidistant speeds.
        second = (fast - 2.0 * middle + slow) / 2.0
        first = (fast - middle) - 5.0 * second
        return cls(
            tangent_rad=path.evaluate(middles())[1],
            inertial=(pushed - fast) / top**2,
            centrifugal=9.0 * second / top**2,
            viscous=3.0 * first / top,
            static_nm=fast - 9.0 * second - 3.0 * first,
        )

    def effort(self, s: FloatArray, ds: FloatArray, dds: FloatArray) -> FloatArray:
        """Return τ at speeds and accelerations along the path. Shapes (m,) to (m, n_joints)."""
        a, b, d, c = (
            along(values, s) for values in (self.inertial, self.centrifugal, self.viscous, self.static_nm)
        )
        return a * dds[:, None] + b * (ds**2)[:, None] + d * ds[:, None] + c


def along(values: FloatArray, s: FloatArray) -> FloatArray:
    """Interpolate columns of values, given at :func:`middles`, at other s. Shape (len(s), n_columns)."""
    return np.column_stack([np.interp(s, middles(), column) for column in values.T])
