"""Whether a joint state follows the one before."""

from __future__ import annotations

from tel_ros.core.types import NS_PER_S


class StateAge:
    """Tells states that say nothing about now: their stamps go back, come after a gap, or are too old.

    Args:
        timeout_s: longest time from one state to the next, and largest age.
    """

    def __init__(self, timeout_s: float) -> None:
        self._timeout_s = timeout_s
        self._timeout_ns = round(timeout_s * NS_PER_S)

    def violation(self, step_ns: int) -> str | None:
        """Return what is wrong with the time since the last state in words, or None."""
        if step_ns <= 0:
            return f"the stamps of the joint states went back by {-step_ns / NS_PER_S:.3f} s"
        if step_ns > self._timeout_ns:
            return f"no joint state for {step_ns / NS_PER_S:.3f} s (time-out {self._timeout_s} s)"
        return None

    def too_old(self, age_s: float) -> str | None:
        """Return what is wrong with a state that was so late in words, or None."""
        if age_s > self._timeout_s:
            return f"the joint states come {age_s:.3f} s late (time-out {self._timeout_s} s)"
        return None
