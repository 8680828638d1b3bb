"""The time that a command spends on its way to the motors."""

from __future__ import annotations

from collections import deque

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
