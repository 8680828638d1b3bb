"""Trajectories as ros2_control's joint_trajectory_controller samples them: splines of what the points tell.

Positions alone make straight lines, with velocities they make cubic and with accelerations quintic splines;
efforts go straight from point to point. The way to the first point begins in the state in which the
trajectory was taken up. After the last point its values stay.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tel_ros.core.errors import TrajectoryError
from tel_ros.core.types import NS_PER_S, FloatArray, IntArray

FIELDS = ("positions", "velocities", "accelerations", "effort")
"""Of a ``trajectory_msgs/JointTrajectoryPoint``, and rows of a sample."""
_POSITION, _VELOCITY, _ACCELERATION, _EFFORT = range(4)


@dataclass(frozen=True)
class Points:
    """What a trajectory says, joints in the controller's order."""

    start_ns: int
    """When it begins; 0: as soon as it is taken up."""
    time_ns: IntArray
    """Of each point, from the start. Shape (n,), increasing."""
    values: FloatArray
    """Position, velocity, acceleration, effort of each point. Shape (n, 4, n_joints); NaN: not given."""

    @classmethod
    def hold(cls, position_rad: FloatArray, effort_nm: FloatArray | float = 0.0) -> Points:
        """Return a trajectory that stays at a position."""
        values = np.zeros((1, len(FIELDS), len(position_rad)))
        values[0, _POSITION], values[0, -1] = position_rad, effort_nm
        return cls(0, np.zeros(1, dtype=np.int64), values)


def points_of(message: Any, joints: Sequence[str], now_ns: int, *, ends_moving: bool = False) -> Points:
    """Return the points of a ``trajectory_msgs/JointTrajectory``; TrajectoryError: it cannot be followed.

    Refused is what the real controller rejects by default: other joints, no points, times that do not
    increase, an end in the past or (unless ``ends_moving``) in motion, fields of other lengths. And what it
    takes, with a command that is no number or a jump to zero: values that are not finite, efforts of another
    length, accelerations without velocities.
    """
    names, points = list(message.joint_names), message.points
    if sorted(names) != sorted(joints):
        raise TrajectoryError(f"joints of the trajectory: {names}; expected each of {list(joints)} once")
    if not points:
        raise TrajectoryError("the trajectory has no points")
    order = [names.index(joint) for joint in joints]
    values = np.full((len(points), len(FIELDS), len(joints)), math.nan)
    for k, point in enumerate(points):
        for row, field in enumerate(FIELDS):
            given = getattr(point, field)
            if len(given) == len(joints):
                values[k, row] = given
                if not np.isfinite(values[k, row]).all():
                    raise TrajectoryError(f"{field} of point {k} are {list(given)}; expected finite numbers")
            elif len(given) or field == "positions":
                raise TrajectoryError(
                    f"point {k} has {len(given)} {field}; expected one for each of {len(joints)} joints"
                )
        if len(point.accelerations) and not len(point.velocities):
            raise TrajectoryError(f"point {k} has accelerations without velocities")
    last = values[-1, _VELOCITY]
    if not ends_moving and np.any(np.abs(last) > np.finfo(np.float32).eps):
        raise TrajectoryError(f"the trajectory ends in motion: velocities {last.tolist()} rad/s; expected 0")
    time_ns = np.array([_ns(point.time_from_start) for point in points], dtype=np.int64)
    if time_ns[0] < 0 or np.any(np.diff(time_ns) <= 0):
        raise TrajectoryError("the times of the points do not increase from 0 s on")
    start_ns = _ns(message.header.stamp)
    if start_ns and start_ns + time_ns[-1] < now_ns:
        late_s = (now_ns - start_ns - time_ns[-1]) / NS_PER_S
        raise TrajectoryError(f"the trajectory has ended {late_s:.3f} s ago, by the time of its header")
    return Points(start_ns, time_ns, values[:, :, order])


def _ns(stamp: Any) -> int:
    return int(stamp.sec) * NS_PER_S + int(stamp.nanosec)


class Spline:
    """A trajectory that is taken up ``now_ns``.

    ``before``: the state that it begins in, shaped like a point, and ``since_ns``: when that was.
    """

    def __init__(self, points: Points, now_ns: int, since_ns: int, before: FloatArray) -> None:
        self.start_ns = points.start_ns or now_ns
        times_ns, values = self.start_ns + points.time_ns, points.values
        self.end_ns = int(times_ns[-1])
        # The state has no acceleration: it counts as zero, so that the way there is no other kind of spline.
        before = np.where(np.isnan(before) & ~np.isnan(values[0]), 0.0, before)
        if now_ns < times_ns[0]:
            times_ns, values = np.append(since_ns, times_ns), np.concatenate([before[None], values])
        self._times_ns: list[int] = times_ns.tolist()
        self._last = np.nan_to_num(values[-1])
        self._coefficients = _coefficients(times_ns, values)

    def sample(self, time_ns: int) -> FloatArray:
        """Return position, velocity, acceleration and effort, shape (4, n_joints)."""
        k = bisect_right(self._times_ns, time_ns) - 1
        if k >= len(self._coefficients):
            return self._last
        t = (time_ns - self._times_ns[max(0, k)]) / NS_PER_S
        t2 = t * t
        t3, t4 = t2 * t, t2 * t2
        powers = (
            (1.0, t, t2, t3, t4, t4 * t, 0.0, 0.0),
            (0.0, 1.0, 2.0 * t, 3.0 * t2, 4.0 * t3, 5.0 * t4, 0.0, 0.0),
            (0.0, 0.0, 2.0, 6.0 * t, 12.0 * t2, 20.0 * t3, 0.0, 0.0),
            (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, t),
        )
        found: FloatArray = np.array(powers) @ self._coefficients[max(0, k)]
        return found


def _coefficients(times_ns: IntArray, values: FloatArray) -> FloatArray:
    """Return six of each polynomial of positions and two of the efforts, shape (n - 1, 8, n_joints)."""
    duration = np.diff(times_ns)[:, None] / NS_PER_S
    known = ~np.isnan(values)
    p, v, a, effort = np.moveaxis(np.nan_to_num(values), 1, 0)
    has_v = known[:-1, _VELOCITY] & known[1:, _VELOCITY]
    has_a = has_v & known[:-1, _ACCELERATION] & known[1:, _ACCELERATION]
    # What is left of the way, the change of velocity and that of acceleration, as shares of one duration.
    v0, a0 = np.where(has_v, v[:-1], 0.0), np.where(has_a, a[:-1], 0.0)
    way = p[1:] - p[:-1] - duration * (v0 + 0.5 * duration * a0)
    faster = np.where(has_v, duration * (v[1:] - v0 - duration * a0), 0.0)
    harder = np.where(has_a, duration**2 * (a[1:] - a0), 0.0)
    straight = np.where(has_v, 0.0, way)
    cubic = has_v & ~has_a
    square = np.where(cubic, 3.0 * way - faster, 0.0)
    third = np.where(
        has_a, 10.0 * way - 4.0 * faster + 0.5 * harder, np.where(cubic, faster - 2.0 * way, 0.0)
    )
    fourth = np.where(has_a, -15.0 * way + 7.0 * faster - harder, 0.0)
    fifth = np.where(has_a, 6.0 * way - 3.0 * faster + 0.5 * harder, 0.0)
    return np.stack(
        [
            p[:-1],
            v0 + straight / duration,
            0.5 * a0 + square / duration**2,
            third / duration**3,
            fourth / duration**4,
            fifth / duration**5,
            effort[:-1],
            np.diff(effort, axis=0) / duration,
        ],
        axis=1,
    )
