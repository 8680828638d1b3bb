"""The time that a command spends on its way to the motors."""

from __future__ import annotations

from collections import deque

from tel_ros.core.config import JointValues


class CommandDelay:
    """A line of commands that moves on by one place a control period; it is filled with zeros at first.

    Args:
        n_periods: control periods between a command and its effect; 0: none.
        n_joints: number of values in a command.
    """

    def __init__(self, n_periods: int, n_joints: int) -> None:
        self._zero: JointValues = (0.0,) * n_joints
        self._n_periods = n_periods
        self._on_the_way: deque[JointValues] = deque()
        self.clear()

    def pass_through(self, command: JointValues) -> JointValues:
        """Take the command of this period and return the one that arrives in it."""
        if self._n_periods == 0:
            return command
        self._on_the_way.append(command)
        return self._on_the_way.popleft()

    def clear(self) -> None:
        """Forget every command that is still on its way: zeros arrive instead."""
        self._on_the_way.clear()
        self._on_the_way.extend([self._zero] * self._n_periods)
