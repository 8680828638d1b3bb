"""How regularly the control loop was fed during a trial, and how fast it answered.

It says something only where time passes by itself: on a real arm and on the simulated one in real time. In
lockstep the arm waits for each answer, and nothing is measured.
"""

from __future__ import annotations

import math
from array import array
from dataclasses import replace

import numpy as np

from tel_ros.core.trial import LoopTiming
from tel_ros.core.types import NS_PER_S, IntArray

RATE_TOLERANCE = 0.02
"""A rate further off than this share of the configured one is warned about."""
MISSED_SHARE = 0.005
"""More missed ticks than this share of all are warned about."""
LATE_PERIODS = 0.5
"""Jitter or response at the 99th percentile beyond this many periods is warned about: the command then acts
half a period late, which is the lag that a sampled loop has anyway."""
LONGEST_GAP_S = 0.02
"""A single state later than this is warned about: the age at which ``tel check`` calls a state stale."""


def missed_ticks(stamps_ns: IntArray, rate_hz: float) -> int:
    """Return how many periods had no state of their own, by the stamps of those that were answered.

    A state that is late by more than half a period leaves its place empty, as one does that never came; n
    periods between two stamps are n - 1 missed ticks.
    """
    periods = np.diff(stamps_ns) * (rate_hz / NS_PER_S)
    return int(np.maximum(np.ceil(periods - 0.5) - 1.0, 0.0).sum())


class LoopTimer:
    """Notes three times a tick, in memory for ``capacity`` ticks that is there before the trial begins."""

    def __init__(self, rate_hz: float, capacity: int) -> None:
        self._rate_hz = rate_hz
        # Plain arrays: their elements are set faster than NumPy's. Written to, not only reserved: the first
        # write to a page interrupts the loop.
        self._stamps_ns, self._arrived_ns, self._answered_ns = (_room(max(capacity, 2)) for _ in range(3))
        self._n = 0

    def reset(self) -> None:
        """Begin a trial."""
        self._n = 0

    def add(self, stamp_ns: int, arrived_ns: int, answered_ns: int) -> None:
        """Note a state that has been answered: taken and answered by the same monotonic clock."""
        n = self._n
        if n == len(self._stamps_ns):
            for times_ns in (self._stamps_ns, self._arrived_ns, self._answered_ns):
                times_ns.extend(_room(n))
        self._stamps_ns[n], self._arrived_ns[n], self._answered_ns[n] = stamp_ns, arrived_ns, answered_ns
        self._n = n + 1

    def timing(self) -> LoopTiming | None:
        """Return the figures since the last reset; None if fewer than two states were answered."""
        if self._n < 2:
            return None
        times_ns = (self._stamps_ns, self._arrived_ns, self._answered_ns)
        stamps_ns, arrived_ns, answered_ns = (np.array(each[: self._n], dtype=np.int64) for each in times_ns)
        # The arm is held by the last command meanwhile: two partitions, and nothing is sorted.
        jitter_ns = np.abs(np.diff(arrived_ns) - round(NS_PER_S / self._rate_hz))
        response_ns: IntArray = answered_ns - arrived_ns
        p50_s, p99_s = _percentiles_s(jitter_ns, 0.5, 0.99)
        (response_p99_s,) = _percentiles_s(response_ns, 0.99)
        timing = LoopTiming(
            state_rate_hz=_rate_hz(arrived_ns),
            stamp_rate_hz=_rate_hz(stamps_ns),
            jitter_p50_s=p50_s,
            jitter_p99_s=p99_s,
            jitter_max_s=int(jitter_ns.max()) / NS_PER_S,
            response_p99_s=response_p99_s,
            response_max_s=int(response_ns.max()) / NS_PER_S,
            missed_ticks=missed_ticks(stamps_ns, self._rate_hz),
        )
        return replace(timing, warning=_warning(timing, self._rate_hz, self._n))


def _room(n: int) -> array[int]:
    return array("q", bytes(8 * n))


def _percentiles_s(values_ns: IntArray, *shares: float) -> tuple[float, ...]:
    """Return for each share the value that so many values are not above."""
    ranks = [max(0, math.ceil(share * len(values_ns)) - 1) for share in shares]
    parted = np.partition(values_ns, ranks)
    return tuple(int(parted[rank]) / NS_PER_S for rank in ranks)


def _rate_hz(times_ns: IntArray) -> float:
    span_ns = int(times_ns[-1] - times_ns[0])
    # Stamps that stand still or go back have no rate; the trial was aborted then.
    return (len(times_ns) - 1) * NS_PER_S / span_ns if span_ns > 0 else float("nan")


def _warning(timing: LoopTiming, rate_hz: float, n_answered: int) -> str:
    period_s, n_periods = 1.0 / rate_hz, n_answered + timing.missed_ticks
    # Written so that NaN is found as well.
    found = [
        f"{what} {rate:.1f} Hz instead of {rate_hz:g} Hz"
        for what, rate in (("states came at", timing.state_rate_hz), ("stamps show", timing.stamp_rate_hz))
        if not abs(rate / rate_hz - 1.0) <= RATE_TOLERANCE
    ]
    if not timing.missed_ticks <= MISSED_SHARE * n_periods:
        found.append(f"{timing.missed_ticks} of {n_periods} ticks were missed")
    found += [
        f"1 in 100 {what} {1e3 * late_s:.2f} ms or more (period {1e3 * period_s:.2f} ms)"
        for what, late_s in (
            ("states was early or late by", timing.jitter_p99_s),
            ("answers took", timing.response_p99_s),
        )
        if not late_s <= LATE_PERIODS * period_s
    ]
    if not timing.jitter_max_s <= max(LONGEST_GAP_S, period_s):
        found.append(f"one state was {1e3 * timing.jitter_max_s:.1f} ms late")
    return f"the loop was not regular: {'; '.join(found)}" if found else ""
