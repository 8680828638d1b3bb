"""A movement as points of a trajectory with efforts, for ros2_control's joint_trajectory_controller.

With an effort command interface that controller commands ff_velocity_scale ẏ + τ + p (y - q) + d (ẏ - q̇),
where τ is the effort of the trajectory one period h later. With p = K, d = B and ff_velocity_scale = 0 this
is K (û - q) - B q̇, the law of practice, if τ = K (û - y) - B ẏ: what springs exert in the desired state.

Practice holds û for a period T of its own, so that it acts T / 2 later in the mean, and has learned to make
up for that. The controller's efforts act h / 2 before their time. So they come (T + h) / 2 later here.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from tel_ros.core.springs import Springs
from tel_ros.core.types import NS_PER_S, FloatArray, IntArray


class ErrorCode(IntEnum):
    """How an execution ended; numbers as in ``FollowJointTrajectory.action``."""

    SUCCESSFUL = 0
    INVALID_GOAL = -1
    INVALID_JOINTS = -2
    OLD_HEADER_TIMESTAMP = -3
    PATH_TOLERANCE_VIOLATED = -4
    GOAL_TOLERANCE_VIOLATED = -5


@dataclass(frozen=True)
class TrajectoryPoints:
    """Times from the start, shape (n,), and what is wanted then. Arrays of shape (n, n_joints)."""

    time_ns: IntArray
    position_rad: FloatArray
    velocity_rad_s: FloatArray
    acceleration_rad_s2: FloatArray
    effort_nm: FloatArray

    @classmethod
    def of(
        cls,
        springs: Springs,
        time_ns: IntArray,
        desired: tuple[FloatArray, FloatArray, FloatArray],
        equilibrium_rad: FloatArray,
        *,
        limit_nm: FloatArray,
        periods_s: tuple[float, float],
        lost_rad: float,
    ) -> TrajectoryPoints:
        """Return the points of a movement that was practised at the times ``time_ns``.

        ``desired``: position, velocity, acceleration. ``limit_nm``: of the efforts, shape (n_joints,).
        ``periods_s``: of practice and of the controller. ``lost_rad``: how far û may be from its own between
        two points; see :func:`thinned`.
        """
        exerted_nm = springs.effort(equilibrium_rad, *desired[:2]).clip(-limit_nm, limit_nm)
        late_ns = 0.5 * sum(periods_s) * NS_PER_S
        # One point more: the last is held, and efforts end later than positions.
        times_ns = np.append(time_ns, time_ns[-1] + round(2.0 * late_ns))
        effort_nm = np.column_stack([np.interp(times_ns - late_ns, time_ns, each) for each in exerted_nm.T])
        position, velocity, acceleration = (np.vstack([each, each[-1:]]) for each in desired)
        acceleration[-1] = 0.0
        kept = thinned(times_ns, effort_nm / springs.stiffness_nm_per_rad, lost_rad)
        return cls(times_ns[kept], position[kept], velocity[kept], acceleration[kept], effort_nm[kept])

    def after(self, rest_ns: int, period_ns: int) -> TrajectoryPoints:
        """Return them with a rest in the first position before, with its effort.

        A controller hurries an arm from where it is to the first point of a trajectory that begins later, and
        under a weight it is not there. ``period_ns``: in which an acceleration may set in after the rest.
        """
        times_ns = np.concatenate([[0, rest_ns - period_ns], rest_ns + self.time_ns])
        position, velocity, acceleration, effort = (
            np.vstack([each[:1], each[:1], each])
            for each in (self.position_rad, self.velocity_rad_s, self.acceleration_rad_s2, self.effort_nm)
        )
        velocity[:2] = acceleration[:2] = 0.0
        return TrajectoryPoints(times_ns, position, velocity, acceleration, effort)


def thinned(time_ns: IntArray, values: FloatArray, lost: float) -> IntArray:
    """Return the points to keep, evenly, so that straight lines between them lose no more than ``lost``.

    Positions lose less: quintic splines go through them. Shapes (n,), (n, n_joints) and (n_kept,).
    """
    n = len(time_ns)
    for every in range(50, 1, -1):
        kept = np.unique(np.append(np.arange(0, n, every), n - 1))
        lines = np.column_stack([np.interp(time_ns, time_ns[kept], column[kept]) for column in values.T])
        if np.max(np.abs(lines - values)) <= lost:
            return kept
    return np.arange(n)
