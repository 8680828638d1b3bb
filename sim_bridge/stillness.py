"""Whether an arm has stood still lately, by what its controller can see of it."""

from __future__ import annotations

from collections import deque

from tel_ros.core.config import ControlConfig, JointValues

_TIMES = 3.0
"""The controller's rest allows the distance once to each side of where its window began; and the arm has
moved on for a period since."""


class Stillness:
    """Remembers the last readings, and says whether a controller may have taken them for rest.

    A controller that is silent between trials leaves an arm behind that swings a little still, and its speed
    of the moment says nothing. So what counts is how far it has moved over the settling time, by the measure
    of :class:`~tel_ros.core.control.holding.RestDetector`: whatever that calls rest is rest here, too.

    Args:
        control: rate, settling time and speed.
    """

    def __init__(self, control: ControlConfig) -> None:
        self._furthest_rad = _TIMES * control.settle_speed_rad_s * control.settle_time_s
        self._readings: deque[JointValues] = deque(maxlen=round(control.settle_time_s * control.rate_hz) + 1)

    def add(self, position_rad: JointValues) -> None:
        """Take in the reading of a period."""
        self._readings.append(position_rad)

    @property
    def stands_still(self) -> bool:
        """Whether no joint has moved far, over the window or for as long as there have been readings."""
        return all(
            max(joint) - min(joint) <= self._furthest_rad for joint in zip(*self._readings, strict=True)
        )
