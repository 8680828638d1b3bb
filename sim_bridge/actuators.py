"""Between a command and the torque of a motor: the time on the way, and a position drive."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from tel_ros.core.config import JointValues


class CommandDelay:
    """A line of commands that moves on by one place a control period, filled with ``at_rest`` at first."""

    def __init__(self, n_periods: int, at_rest: JointValues) -> None:
        self._on_the_way = deque([at_rest] * n_periods)

    def pass_through(self, command: JointValues) -> JointValues:
        """Take the command of this period and return the one that arrives in it."""
        self._on_the_way.append(command)
        return self._on_the_way.popleft()

    def clear(self, at_rest: JointValues) -> None:
        """Forget every command that is still on its way: this one arrives instead."""
        self._on_the_way = deque([at_rest] * len(self._on_the_way))


@dataclass(frozen=True)
class PositionDrive:
    """The control law τ = K (u - q) - B q̇ with |τ| limited, as a drive evaluates it at its own, high rate.

    Its position and velocity are the true ones: a drive measures finer than what the joint states tell.
    """

    stiffness_nm_per_rad: JointValues
    damping_nms_per_rad: JointValues
    effort_limit_nm: JointValues

    def effort_nm(
        self, set_point_rad: JointValues, position_rad: JointValues, velocity_rad_s: JointValues
    ) -> JointValues:
        """Return the torque of each motor at a state, for a set point u."""
        return tuple(
            max(-limit, min(limit, k * (u - q) - b * v))
            for k, b, limit, u, q, v in zip(
                self.stiffness_nm_per_rad,
                self.damping_nms_per_rad,
                self.effort_limit_nm,
                set_point_rad,
                position_rad,
                velocity_rad_s,
                strict=True,
            )
        )
