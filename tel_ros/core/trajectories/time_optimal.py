"""Time-optimal timings: a path as fast as bounds on efforts, their rates and velocities allow.

Along a path a rigid arm needs the efforts τ = a(s) s̈ + b(s) ṡ² + d(s) ṡ + c(s): from inertia, centrifugal
and Coriolis forces, viscous friction, and gravity with dry friction, whose sign the path gives (Bobrow et al.
1985). In x = ṡ² at points of the path the time ∫ ds / √x is convex, s̈ = x' / 2 and bounds on efforts and
velocities are linear (Verscheure et al. 2009). Viscous friction and bounds on the rate of efforts are not
convex: they are replaced by their tangents, which err to the safe side, or vanish, as the solution is
approached. An interior-point method solves it; its matrices are banded, so that a path takes some tenths
of a second. (TOPP-RA finds the optimum without bounds on rates; smoothing it afterwards costs 5 % of the
time. Both agree where both apply.)
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy  # loads its parts when they are first used: half a second that most processes do without

from tel_ros.core.errors import TrajectoryError
from tel_ros.core.trajectories.path_dynamics import INTERVALS, PathDynamics, knots, middles
from tel_ros.core.trajectories.timing import MinimumJerk, SmoothedSpeed, minimum_jerk
from tel_ros.core.types import FloatArray

_TO_SPARE = 0.5
"""Of the bounds: what the timing to begin with leaves."""
_SLOWEST_PER_S, _FASTEST_PER_S = 1e-4, 1e4
_BISECTIONS, _FINE_BISECTIONS = 16, 30
_RETREAT = 0.99
_GAPS = (1.0, 0.2, 0.05, 0.01, 3e-3, 1e-3)
"""Upper bounds on the time that may still be won, as shares of it, from stage to stage."""
_NEWTON_STEPS = 60
"""Of a stage at most; with 12 movements came out 8 % slower than with enough, and twice as slow where joint
velocities are the limit."""
_BACKTRACKS = 40
_LEAST_ROOM = 1e-3
"""Of the effort limit: what gravity and dry friction have to leave of the bounds."""


class EffortBounds(NamedTuple):
    """low <= τ + k ṡ <= high. Shapes (n, n_joints) at :func:`middles`."""

    low_nm: FloatArray
    high_nm: FloatArray
    damping_nms: FloatArray
    """k."""


@dataclass(frozen=True)
class Bounds:
    """What a timing has to keep."""

    efforts: Sequence[EffortBounds]
    rate_nm_per_s: FloatArray
    """Of what the motion adds to gravity and dry friction. Shape (n_joints,)."""
    velocity_rad_s: FloatArray
    """Largest |q̇|. Shape (n, n_joints) at :func:`middles`."""


def room(
    dynamics: PathDynamics, limit_nm: FloatArray, share: float, most: float, joints: Sequence[str]
) -> EffortBounds:
    """Return bounds on efforts that leave ``share`` / ``most`` of the room that there is at ``most`` · limit.

    The room is what gravity and dry friction leave. Scaled by p it lets an arm run a path in 1 / √p of the
    time, whatever gravity it has (Hollerbach 1984; but for viscous friction).

    Raises:
        TrajectoryError: they leave none.
    """
    high, low, c = most * limit_nm, -most * limit_nm, dynamics.static_nm
    left = np.minimum(high - c, c - low)
    if not np.all(left >= _LEAST_ROOM * limit_nm):
        k, j = divmod(int(np.argmin(left / limit_nm)), left.shape[1])
        raise TrajectoryError(
            f"{joints[j]} needs {abs(c[k, j]):.1f} N·m against gravity and friction at "
            f"{100 * middles()[k]:.0f} % of the path, and may use {most * limit_nm[j]:.1f} N·m"
        )
    p = share / most
    return EffortBounds(c - p * (c - low), c + p * (high - c), np.zeros_like(c))


class _Rows(NamedTuple):
    """Linear constraints Σ_i coefficients[i, k] x[first + k + i] <= constant[k].

    Shapes (width, n, n_joints) and (n, n_joints).
    """

    coefficients: FloatArray
    constant: FloatArray
    first: int = 0

    def slack(self, x: FloatArray) -> FloatArray:
        """Return what is left of the constants. Shape (n, n_joints)."""
        n = self.constant.shape[0]
        slack = self.constant.copy()
        for i, coefficient in enumerate(self.coefficients):
            slack -= coefficient * x[self.first + i : self.first + i + n, None]
        return slack


def time_optimal(dynamics: PathDynamics, bounds: Bounds) -> SmoothedSpeed:
    """Return the fastest timing within bounds, but for a thousandth of its time.

    Raises:
        TrajectoryError: there is none.
    """
    ds = np.diff(knots())
    x = _feasible(dynamics, bounds, ds)
    for gap in _GAPS:
        while not _holds(rows := _constraints(dynamics, bounds, ds, x), x):
            x *= _RETREAT
        n_rows = sum(row.constant.size for row in rows)
        weight = n_rows / (gap * float(_times(ds, np.sqrt(x)).sum()))
        x = _centred(ds, rows, weight, x)
    speed = np.sqrt(x)
    times_s = _times(ds, speed)
    # From interval to interval the acceleration jumps, but for this.
    window_s = float(times_s.max())
    return SmoothedSpeed(np.concatenate([[0.0], np.cumsum(times_s)]), knots(), speed, window_s)


def fastest_minimum_jerk(dynamics: PathDynamics, bounds: Bounds) -> MinimumJerk:
    """Return the fastest minimum-jerk timing within bounds on efforts and velocities.

    Raises:
        TrajectoryError: there is none.
    """
    shape, ds = _shape(), np.diff(knots())
    low, high = _SLOWEST_PER_S, _FASTEST_PER_S
    for _ in range(_FINE_BISECTIONS):
        middle = math.sqrt(low * high)
        rows = _constraints(dynamics, bounds, ds, middle**2 * shape)
        low, high = (middle, high) if _holds(rows, middle**2 * shape) else (low, middle)
    return MinimumJerk(1.0 / low)


def _holds(rows: Iterable[_Rows], x: FloatArray, share: float = 0.0) -> bool:
    """Return whether constraints hold, with at least a share of each bound to spare."""
    return all(np.all(row.slack(x) > share * np.abs(row.constant)) for row in rows)


def _times(ds: FloatArray, speed: FloatArray) -> FloatArray:
    return 2.0 * ds / (speed[:-1] + speed[1:])


def _shape() -> FloatArray:
    """Return (ds/dp)² of the minimum-jerk time scaling at :func:`knots`."""
    return minimum_jerk(np.linspace(0.0, 1.0, INTERVALS + 1))[1] ** 2


def _feasible(dynamics: PathDynamics, bounds: Bounds, ds: FloatArray) -> FloatArray:
    """Return x of a minimum-jerk timing that uses half of the bounds at most."""
    shape = _shape()
    low, high = _SLOWEST_PER_S**2, _FASTEST_PER_S**2
    for _ in range(_BISECTIONS):
        middle = math.sqrt(low * high)
        rows = _constraints(dynamics, bounds, ds, middle * shape)
        low, high = (middle, high) if _holds(rows, middle * shape, _TO_SPARE) else (low, middle)
    x = low * shape
    if not _holds(_constraints(dynamics, bounds, ds, x), x):
        raise TrajectoryError("there is no timing with which the arm may follow the path, however slow")
    return x


def _constraints(dynamics: PathDynamics, bounds: Bounds, ds: FloatArray, x: FloatArray) -> list[_Rows]:
    """Return the constraints, linear or made so at x."""
    speed = np.sqrt(x)
    total = speed[:-1] + speed[1:]
    mean_speed = np.sqrt(0.5 * (x[:-1] + x[1:]))[:, None]
    c = dynamics.static_nm
    inertial, centrifugal = dynamics.inertial / (2.0 * ds[:, None]), 0.5 * dynamics.centrifugal
    of_motion = np.stack([centrifugal - inertial, centrifugal + inertial])

    def with_damping(damping: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the coefficients and the constant of what motion adds; √x is replaced by its tangent."""
        return of_motion + 0.25 * damping / mean_speed, 0.5 * damping * mean_speed

    added, offset = with_damping(dynamics.viscous)
    # The time of each interval as a tangent.
    rate = bounds.rate_nm_per_s
    with np.errstate(divide="ignore", invalid="ignore"):
        t = _times(ds, speed)
        t1 = np.where(x[:-1] > 0.0, -ds / (total**2 * speed[:-1]), 0.0)
        t2 = np.where(x[1:] > 0.0, -ds / (total**2 * speed[1:]), 0.0)
    t0 = t - t1 * x[:-1] - t2 * x[1:]
    n, n_joints = c.shape
    change = np.zeros((3, n - 1, n_joints))
    change[:2] -= added[:, :-1]
    change[1:] += added[:, 1:]
    jump = offset[1:] - offset[:-1]
    time = 0.5 * np.stack([t1[:-1], t2[:-1] + t1[1:], t2[1:]])[:, :, None] * rate
    allowed = 0.5 * (t0[:-1] + t0[1:])[:, None] * rate
    tangent = dynamics.tangent_rad**2 / bounds.velocity_rad_s**2
    rest = []
    for k in (0, n - 1):  # from rest, and back to it
        # In the middle of the interval half of its time has passed.
        of_time = 0.5 * np.stack([t1[k], t2[k]])[:, None, None] * rate
        of_effort = added[:, k : k + 1]
        for sign in (1.0, -1.0):
            constant = 0.5 * t0[k] * rate - sign * offset[k]
            rest.append(_Rows(sign * of_effort - of_time, constant[None], k))
    efforts = []
    for low, high, damping in bounds.efforts:
        needed, constant = with_damping(dynamics.viscous + damping)
        efforts += [_Rows(needed, high - c - constant), _Rows(-needed, c - low + constant)]
    return [
        *efforts,
        _Rows(change - time, allowed - jump),
        _Rows(-change - time, allowed + jump),
        _Rows(np.stack([0.5 * tangent, 0.5 * tangent]), np.ones_like(tangent)),
        *rest,
    ]


def _centred(ds: FloatArray, rows: list[_Rows], weight: float, x: FloatArray) -> FloatArray:
    """Return the minimum of weight · time minus the logarithms of all slacks, from a feasible x on."""

    def value(x: FloatArray) -> float:
        if not np.all(x[1:-1] > 0.0):
            return np.inf
        total = weight * float(_times(ds, np.sqrt(x)).sum()) - float(np.log(x[1:-1]).sum())
        for row in rows:
            slack = row.slack(x)
            if not np.all(slack > 0.0):
                return np.inf
            total -= float(np.log(slack).sum())
        return total

    now = value(x)
    for _ in range(_NEWTON_STEPS):
        gradient, bands = _derivatives(ds, rows, weight, x)
        step = np.zeros_like(x)
        step[1:-1] = scipy.linalg.solveh_banded(bands[:, 1:-1], -gradient[1:-1], lower=True)
        slope = float(gradient @ step)
        if -slope < 1e-2:
            break
        length = 1.0
        for _ in range(_BACKTRACKS):
            then = value(x + length * step)
            if then <= now + 0.1 * length * slope:
                break
            length *= 0.5
        else:
            break
        x, now = x + length * step, then
    return x


def _derivatives(
    ds: FloatArray, rows: list[_Rows], weight: float, x: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return gradient and Hessian of what :func:`_centred` minimises, the latter as lower bands.

    Shapes (n + 1,) and (3, n + 1); what belongs to the ends, which are at rest, is without meaning.
    """
    speed = np.sqrt(x)
    gradient, bands = np.zeros_like(x), np.zeros((3, len(x)))
    total = speed[:-1] + speed[1:]
    # Their own speeds would divide by zero; nothing depends on them.
    speed[[0, -1]] = 1.0
    for mine in (slice(0, -1), slice(1, None)):
        r = speed[mine]
        gradient[mine] -= weight * ds / (total**2 * r)
        bands[0, mine] += weight * ds * (1.0 / (total**3 * r**2) + 0.5 / (total**2 * r**3))
    bands[1, :-1] = weight * ds / (total**3 * speed[:-1] * speed[1:])
    gradient[1:-1] -= 1.0 / x[1:-1]
    bands[0, 1:-1] += 1.0 / x[1:-1] ** 2
    for row in rows:
        coefficients, constant, first = row
        n = len(constant)
        inverse = 1.0 / row.slack(x)
        scaled = coefficients * inverse
        for i, mine in enumerate(scaled):
            gradient[first + i : first + i + n] += mine.sum(axis=1)
            for j in range(i + 1):
                bands[i - j, first + j : first + j + n] += np.einsum("kj,kj->k", mine, scaled[j])
    return gradient, bands
