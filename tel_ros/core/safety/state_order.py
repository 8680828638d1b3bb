"""Joint states that a newer one has overtaken on the way."""

from __future__ import annotations

from tel_ros.core.types import NS_PER_S


class StateOrder:
    """Tells a state that comes after a newer one from a clock that was set back.

    What a newer state has overtaken says nothing about now: a damper that answers it brakes a speed of
    before, which drives light joints beyond their limits within a few periods. It is to be passed over, as
    if it had got lost. Stamps that go back by the time-out or more are of a clock that was set; they count
    from then on. Where a clock was set back by less, states are passed over until it has caught up: for
    less than the time-out, then.

    Args:
        timeout_s: longest time without a new state.
    """

    def __init__(self, timeout_s: float) -> None:
        self._timeout_ns = round(timeout_s * NS_PER_S)
        self._newest_ns: int | None = None

    def overtaken_by_s(self, stamp_ns: int) -> float:
        """Take in a stamp; return by how much a state is older than the newest, 0 if it is to be used."""
        newest_ns = self._newest_ns
        if newest_ns is not None and 0 < newest_ns - stamp_ns < self._timeout_ns:
            return (newest_ns - stamp_ns) / NS_PER_S
        self._newest_ns = stamp_ns
        return 0.0
