"""Which periods of the simulated arm are due, by the clock on the wall."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Due:
    """What has to be made up for.

    Args:
        periods: that pass now, one after the other; 0: it is too early.
        skipped_s: time that passes without the arm.
    """

    periods: int
    skipped_s: float = 0.0


class Pacer:
    """Keeps the arm's time equal to that on the wall.

    Deadlines are absolute, so that being late once does not make all that follows late. After a stall all
    periods that have gone by pass at once, and the arm is seen where it is by then, as an arm of steel would
    be: it does not wait for a computer that stands still. What goes beyond ``longest_s`` is skipped: an arm
    without commands has long been coasting by then.

    Args:
        period_s: of control.
        now_s: by a monotonic clock; the first period ends one period later.
        longest_s: of a stall that is simulated.
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
