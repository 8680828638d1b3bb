"""What a FollowJointTrajectory goal asks for, and the smooth reference through its points."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy  # loads its parts when they are first used

from tel_ros.core.control.trajectory_points import ErrorCode
from tel_ros.core.errors import TelError
from tel_ros.core.trajectories.trajectory import DesiredTrajectory
from tel_ros.core.types import NS_PER_S, FloatArray, IntArray

_SAME_RAD, _SAME_NS = 1e-3, 10_000_000
"""Trajectories whose points agree to this are one movement."""
_REST_RAD_S = 1e-3


class RefusedError(TelError):
    """A trajectory is not executed; nothing has moved."""

    def __init__(self, reason: str, code: ErrorCode = ErrorCode.INVALID_GOAL) -> None:
        self.code = code
        super().__init__(reason)


@dataclass(frozen=True)
class Points:
    """Points of a trajectory in the order of the arm's joints; see :func:`requested`.

    Shapes (n,) and (n, n_joints); a field that the goal leaves out is None.
    """

    time_ns: IntArray
    position_rad: FloatArray
    velocity_rad_s: FloatArray | None = None
    acceleration_rad_s2: FloatArray | None = None

    @property
    def key(self) -> str:
        """The same for every request of the same movement."""
        digest = hashlib.sha256(np.round(self.time_ns / _SAME_NS).astype(np.int64).tobytes())
        digest.update(np.round(self.position_rad / _SAME_RAD).astype(np.int64).tobytes())
        return digest.hexdigest()[:16]


def requested(
    joints: Sequence[str],
    named: Sequence[str],
    time_ns: Sequence[int],
    positions: Sequence[Sequence[float]],
    velocities: Sequence[Sequence[float]],
    accelerations: Sequence[Sequence[float]],
) -> Points:
    """Return the points of a goal for the arm with these joints, as joint_trajectory_controller takes them.

    ``named``: the goal's joints, in any order. Of the others one row a point; empty rows: not given.

    Raises:
        RefusedError: other joints, no points, rows of another length, numbers that are not finite, times
            that do not increase, or an end that is not at rest.
    """
    if not named:
        raise RefusedError("Empty joint names on incoming trajectory.", ErrorCode.INVALID_JOINTS)
    if sorted(named) != sorted(joints):
        found, expected = ", ".join(named), ", ".join(joints)
        raise RefusedError(
            f"Joints on incoming trajectory don't match the controller joints: they are {found}; expected "
            f"{expected}",
            ErrorCode.INVALID_JOINTS,
        )
    if not time_ns:
        raise RefusedError("Empty trajectory received.")
    order = [list(named).index(joint) for joint in joints]
    fields = {"positions": positions, "velocities": velocities, "accelerations": accelerations}
    arrays: dict[str, FloatArray | None] = {}
    for name, rows in fields.items():
        lengths = {len(row) for row in rows}
        if lengths == {0} and name != "positions":
            arrays[name] = None
            continue
        if lengths != {len(joints)}:
            k = next(k for k, row in enumerate(rows) if len(row) != len(joints))
            expected = f"{len(joints)}" + ("" if name == "positions" else ", or none in any point")
            raise RefusedError(f"point {k} has {len(rows[k])} {name}; expected {expected}")
        values = np.array(rows, dtype=np.float64)[:, order]
        if not np.all(np.isfinite(values)):
            k, j = np.argwhere(~np.isfinite(values))[0]
            raise RefusedError(
                f"{name} of point {k}: {joints[j]} is {values[k, j]}; expected a finite number"
            )
        arrays[name] = values
    times = np.array(time_ns, dtype=np.int64)
    if times[0] < 0:
        raise RefusedError(f"the first point is at {times[0] / NS_PER_S} s; expected 0 or later")
    if np.any(late := np.diff(times) <= 0):
        k = int(np.argmax(late))
        found = f"it is {times[k] / NS_PER_S} and {times[k + 1] / NS_PER_S} respectively"
        raise RefusedError(f"Time between points {k} and {k + 1} is not strictly increasing, {found}")
    assert arrays["positions"] is not None
    points = Points(times, arrays["positions"], arrays["velocities"], arrays["accelerations"])
    if points.velocity_rad_s is not None:
        for which, row in (("last", -1), *((("first", 0),) if times[0] == 0 else ())):
            j = int(np.argmax(np.abs(points.velocity_rad_s[row])))
            if abs(speed := points.velocity_rad_s[row, j]) > _REST_RAD_S:
                raise RefusedError(
                    f"Velocity of {which} trajectory point of joint {joints[j]} is not zero: {speed:.6f}"
                )
    return points


class Reference:
    """A smooth movement through points, from rest to rest: quintic splines, as JTC makes of full points.

    What the points leave out is filled in: velocities by the cubic spline through the positions that starts
    and ends at rest, accelerations by the mean of those of the cubic pieces on both sides, 0 at both ends.
    (JTC would go in straight lines through bare positions, with jumps that no effort can follow.) Where the
    first point is later than 0, the movement begins where the arm is, at ``here_rad``.
    """

    def __init__(self, points: Points, here_rad: FloatArray) -> None:
        n, still = len(here_rad), np.zeros((1, len(here_rad)))
        time_s, q = points.time_ns / NS_PER_S, points.position_rad
        dq, ddq = points.velocity_rad_s, points.acceleration_rad_s2
        if points.time_ns[0] > 0:
            time_s, q = np.append(0.0, time_s), np.vstack([here_rad, q])
            dq, ddq = (None if each is None else np.vstack([still, each]) for each in (dq, ddq))
        if len(time_s) < 2:
            raise RefusedError("the trajectory ends at 0 s; expected a time in which to get there")
        interpolate = scipy.interpolate
        if dq is None:
            dq = interpolate.CubicSpline(time_s, q, bc_type="clamped")(time_s, 1)
            dq[0] = dq[-1] = 0.0
        if ddq is None:
            pieces = interpolate.CubicHermiteSpline(time_s, q, dq).c  # highest power first
            steps = np.diff(time_s)[:, None]
            ddq = np.zeros((len(time_s), n))
            at_the_end = 6.0 * pieces[0] * steps + 2.0 * pieces[1]
            ddq[1:-1] = 0.5 * (at_the_end[:-1] + 2.0 * pieces[1, 1:])
        self._at = interpolate.BPoly.from_derivatives(time_s, np.stack([q, dq, ddq], axis=1))
        self.duration_s = float(time_s[-1])
        """As requested."""

    def desired(self, slowdown: float, rate_hz: float) -> DesiredTrajectory:
        """Return the movement, so many times slower than requested, at ``rate_hz`` points a second.

        The last point is at the first tick that is not earlier than the end.
        """
        steps = max(1, int(np.ceil(self.duration_s * slowdown * rate_hz - 1e-9)))
        time_ns = np.round(np.arange(steps + 1) * (NS_PER_S / rate_hz)).astype(np.int64)
        over = (time_ns / NS_PER_S / slowdown >= self.duration_s)[:, None]
        at_s = np.minimum(time_ns / NS_PER_S / slowdown, self.duration_s)
        q, dq, ddq = (self._at(at_s, order) for order in range(3))
        still = np.zeros_like(q)
        # A movement that ends between two ticks is at rest at the later one.
        late = over & (np.arange(steps + 1) == steps)[:, None]
        return DesiredTrajectory(
            time_ns, q, np.where(late, still, dq / slowdown), np.where(late, still, ddq / slowdown**2)
        )
