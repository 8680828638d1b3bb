"""Between a command and the torque of a motor: the time on the way, and a position drive."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from tel_ros.core.config import JointValues


class CommandDelay:
    """A line of commands that moves on by one place a control period.

    Args:
        n_periods: control periods between a command and its effect; 0: none.
        at_rest: the command that fills the line at first.
    """

    def __init__(self, n_periods: int, at_rest: JointValues) -> None:
        self._n_periods = n_periods
        self._on_the_way: deque[JointValues] = deque()
        self.clear(at_rest)

    def pass_through(self, command: JointValues) -> JointValues:
        """Take the command of this period and return the one that arrives in it."""
        if self._n_periods == 0:
            return command
        self._on_the_way.append(command)
        return self._on_the_way.popleft()

    def clear(self, at_rest: JointValues) -> None:
        """Forget every command that is still on its way: this one arrives instead."""
        self._on_the_way.clear()
        self._on_the_way.extend([at_rest] * self._n_periods)


@dataclass(frozen=True)
class PositionDrive:
    """The control law τ = K (u - q) - B q̇ with |τ| limited, as a drive evaluates it at its own, high rate.

    Its position and velocity are the true ones: what a drive's own encoder and its rate make of them is
    finer than what the joint states tell.

    Args:
        stiffness_nm_per_rad: K, one value a joint.
        damping_nms_per_rad: B, likewise.
        effort_limit_nm: likewise.
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
