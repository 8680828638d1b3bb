"""How old a joint state is when it arrives, from stamps of a clock that nobody has set."""

from __future__ import annotations

from tel_ros.core.types import NS_PER_S


class Latency:
    """Tells by how much longer than the fastest ones a state was on its way.

    The difference between the time of arrival and the stamp is the time on the way plus a constant, by which
    the two clocks differ. Its minimum so far belongs to the fastest state; what a state has more than that is
    its latency. A stamp that goes back is of a clock that was set, or of another source: the minimum counts
    anew from there.

    Clocks drift, and a minimum that never rose would take a slow clock for states that come later and later.
    So it rises by a share of the time that passes. A latency that grows no faster than that goes unseen,
    and one that stays is forgotten at that rate.

    Args:
        clock_drift: the share, 0 to 1. With 1 nothing is ever late, whatever the stamps do.
    """

    def __init__(self, clock_drift: float) -> None:
        self._clock_drift = clock_drift
        self._least_ns = 0
        self._stamp_ns: int | None = None
        self._arrived_ns = 0

    def of(self, stamp_ns: int, arrived_ns: int) -> float:
        """Take in a state and return how late it is, in s, at least 0.

        Args:
            stamp_ns: when it was measured, by the clock of the arm.
            arrived_ns: when it came, by a clock of this machine that nobody sets.
        """
        offset_ns = arrived_ns - stamp_ns
        if self._stamp_ns is None or stamp_ns < self._stamp_ns:
            self._least_ns = offset_ns
        else:
            risen_ns = self._least_ns + round(self._clock_drift * (arrived_ns - self._arrived_ns))
            self._least_ns = min(risen_ns, offset_ns)
        self._stamp_ns, self._arrived_ns = stamp_ns, arrived_ns
        return (offset_ns - self._least_ns) / NS_PER_S
