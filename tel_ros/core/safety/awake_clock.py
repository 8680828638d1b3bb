"""A clock that does not count the time in which its process stood still."""

from __future__ import annotations


class AwakeClock:
    """Counts time as far as somebody looked at it often enough.

    Who waits for a message that does not come cannot tell whether the sender is gone or its own process, or
    the whole machine, stood still, with the message waiting outside. A gap between two looks therefore counts
    as one step at most.

    Args:
        longest_step_s: how much the clock may advance from one look to the next.
        now_s: of a clock that only runs forward.
    """

    def __init__(self, longest_step_s: float, now_s: float) -> None:
        self._longest_step_s = longest_step_s
        self._looked_at_s = now_s
        self.time_s = 0.0
        """Time spent awake."""

    def look(self, now_s: float) -> float:
        """Return the time spent awake; ``now_s`` is of the same clock as before."""
        self.time_s += min(max(now_s - self._looked_at_s, 0.0), self._longest_step_s)
        self._looked_at_s = now_s
        return self.time_s
