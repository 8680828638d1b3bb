"""When the periods of the simulated arm pass, and whether it has stood still lately."""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

from tel_ros.core.config import ControlConfig, JointValues
from tel_ros.core.types import NS_PER_S


class Due(NamedTuple):
    """How many periods pass now (0: it is too early), and what time passes without the arm."""

    periods: int
    skipped_s: float = 0.0


class Pacer:
    """Keeps the arm's time equal to that on the wall.

    Deadlines are absolute, so that being late once does not make all that follows late. After a stall all
    periods that have gone by pass at once: a real arm does not wait for a computer either. What goes beyond
    ``longest_s`` is skipped: an arm without commands has long been coasting by then. ``now_s``: by a
    monotonic clock; the first period ends one period later. ``longest_s``: of a stall that is simulated.
    """

    def __init__(self, period_s: float, now_s: float, longest_s: float) -> None:
        self._period_s = period_s
        self._most = max(1, math.floor(longest_s / period_s))
        self._start_s = now_s
        self._passed = 0

    @property
    def deadline_s(self) -> float:
        """When the next period ends, by the same clock."""
        return self._start_s + (self._passed + 1) * self._period_s

    def due(self, now_s: float) -> Due:
        """Return the periods that have ended by now, and count them as passed."""
        if now_s < self.deadline_s:
            return Due(0)
        # At least one: the quotient may round to just below what the comparison has found.
        ended = max(1, math.floor((now_s - self._start_s) / self._period_s) - self._passed)
        self._passed += ended
        periods = min(ended, self._most)
        return Due(periods, (ended - periods) * self._period_s)


class Allowance:
    """How many periods may pass at once in lockstep, where no state has a command of its own.

    A client may say up to which state it has dealt with what it was told (:meth:`hear`): then the arm is a
    few states ahead of it, so that nothing that was told is lost, and waits. If the client says nothing more
    for ``timeout_s`` while the arm has something to do, periods pass as in real time. Without such a client
    they pass as fast as they can while there is something to do.
    """

    MOST = 32

    def __init__(self, period_s: float, timeout_s: float, ahead: int) -> None:
        self._period_s, self._timeout_s, self._ahead = period_s, timeout_s, ahead
        self._allowed_ns: int | None = None
        self._waits_since = self._passed_at = -math.inf

    def hear(self, stamp_ns: int, now_s: float) -> None:
        """Take in the stamp of the newest state that the client has dealt with."""
        self._allowed_ns = stamp_ns + round(self._ahead * self._period_s * NS_PER_S)
        self._waits_since = now_s

    def periods(self, stamp_ns: int, now_s: float, *, has_client: bool, busy: bool) -> int:
        """Return how many may pass after the state with this stamp; ``busy``: there is something to do."""
        n = self.MOST if busy and not has_client else 0
        if has_client and self._allowed_ns is not None:
            n = min(self.MOST, round((self._allowed_ns - stamp_ns) / NS_PER_S / self._period_s))
        if not busy:
            self._waits_since = now_s
        elif n <= 0 and now_s - self._waits_since >= self._timeout_s:
            n = int(now_s - self._passed_at >= self._period_s)
        if n > 0:
            self._passed_at = now_s
        return max(0, n)


class Stillness:
    """Remembers the last readings, and says whether a controller may have taken them for rest.

    A controller that is silent between trials leaves an arm behind that swings a little still, and its speed
    of the moment says nothing. What counts is how far it has moved over the settling time: whatever
    :class:`~tel_ros.core.control.holding.RestDetector` calls rest is rest here, too.
    """

    def __init__(self, control: ControlConfig) -> None:
        # The controller's rest allows the distance once to each side of where its window began; and the arm
        # has moved on for a period since.
        self._furthest_rad = 3.0 * control.settle_speed_rad_s * control.settle_time_s
        self._readings: deque[JointValues] = deque(maxlen=round(control.settle_time_s * control.rate_hz) + 1)

    def add(self, position_rad: JointValues) -> None:
        """Take in the reading of a period."""
        self._readings.append(position_rad)

    @property
    def stands_still(self) -> bool:
        """Whether no joint has moved far in the window, or since the first reading."""
        return all(
            max(joint) - min(joint) <= self._furthest_rad for joint in zip(*self._readings, strict=True)
        )
