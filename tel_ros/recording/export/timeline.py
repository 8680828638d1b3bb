"""Where the trials of a run lie in one file: one after another, never on top of each other."""

from __future__ import annotations

from tel_ros.core.types import NS_PER_S

GAP_NS = NS_PER_S
"""Left before a trial whose time had to be moved."""


class Timeline:
    """Places trials, in their order; each keeps its recorded time if that comes after the trial before it.

    A clock that was set back or began anew (a simulated arm that was started again) would have trials lie on
    top of each other. The first of them is moved to :data:`GAP_NS` behind the trial before it, and those that
    follow by as much: the time between them stays.
    """

    def __init__(self) -> None:
        self._shift_ns = 0
        self._end_ns: int | None = None

    def place(self, first_ns: int, last_ns: int) -> int:
        """Return what to add [ns] to the times of the next trial.

        Args:
            first_ns: time of its first message.
            last_ns: time of its last message.
        """
        if self._end_ns is not None and first_ns + self._shift_ns < self._end_ns:
            self._shift_ns = self._end_ns + GAP_NS - first_ns
        self._end_ns = last_ns + self._shift_ns
        return self._shift_ns
