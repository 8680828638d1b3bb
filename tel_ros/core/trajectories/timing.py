"""Timings: how far along a path a movement is at a time, whatever the path looks like."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from tel_ros.core.trajectories.paths import Derivatives
from tel_ros.core.types import NS_PER_S, FloatArray, IntArray

MINIMUM_JERK_PEAK_SPEED = 1.875
"""Peak of ds/dp of the minimum-jerk time scaling, at p = 1/2."""


class Timing(Protocol):
    """From rest at s = 0 to rest at s = 1."""

    @property
    def duration_s(self) -> float:
        """How long the movement takes."""
        ...

    def at(self, time_ns: IntArray) -> Derivatives:
        """Return s, ds/dt [1/s] and d²s/dt² [1/s²], of the shape of ``time_ns``; held beyond the ends."""
        ...


@dataclass(frozen=True)
class MinimumJerk:
    """The smoothest timing of a duration (Flash and Hogan 1985; the paper does not say which one it used)."""

    duration_s: float

    def at(self, time_ns: IntArray) -> Derivatives:
        """See :meth:`Timing.at`."""
        s, ds, dds = minimum_jerk(time_ns / (NS_PER_S * self.duration_s))
        return s, ds / self.duration_s, dds / self.duration_s**2


def minimum_jerk(phase: FloatArray) -> Derivatives:
    """Return s = 10 p³ - 15 p⁴ + 6 p⁵ and its first two derivatives. Shapes (n,).

    ``phase`` is the elapsed share p of the duration; outside 0 … 1 it is held at the ends.
    """
    p = np.clip(phase, 0.0, 1.0)
    # Products, since NumPy's powers differ in the last bit from one processor to another.
    s = p * p * p * (10.0 + p * (-15.0 + 6.0 * p))
    ds = 30.0 * p**2 * (1.0 - p) ** 2
    dds = 60.0 * p * (1.0 - p) * (1.0 - 2.0 * p)
    return s, ds, dds


@dataclass(frozen=True)
class SmoothedSpeed:
    """A timing with constant d²s/dt² between knots, then the mean of its ds/dt over a window of time.

    The mean turns jumps of the acceleration into ramps as long as the window, and makes the movement last
    longer by it. Arrays of shape (n_knots,): times from 0 on, s from 0 to 1, ds/dt from 0 to 0.

    ``rest_s``: how long to stay at rest before.
    """

    knot_s: FloatArray
    travelled: FloatArray
    speed_per_s: FloatArray
    window_s: float
    rest_s: float = 0.0

    @property
    def duration_s(self) -> float:
        """How long the movement takes."""
        return self.rest_s + float(self.knot_s[-1]) + self.window_s

    def at(self, time_ns: IntArray) -> Derivatives:
        """See :meth:`Timing.at`."""
        time_s = np.clip(time_ns / NS_PER_S, 0.0, self.duration_s) - self.rest_s
        now, before = self._integrals(time_s), self._integrals(time_s - self.window_s)
        s, ds, dds = ((a - b) / self.window_s for a, b in zip(now, before, strict=True))
        return np.clip(s, 0.0, 1.0), ds, dds

    def _integrals(self, time_s: FloatArray) -> Derivatives:
        """Return the integral of s over time, s, and ds/dt, before smoothing; at rest beyond both ends."""
        t, s, ds = self.knot_s, self.travelled, self.speed_per_s
        step, rise = np.diff(t), np.diff(ds)
        area = np.concatenate([[0.0], np.cumsum(step * (s[:-1] + step * (ds[:-1] / 2.0 + rise / 6.0)))])
        k = np.clip(np.searchsorted(t, time_s, side="right") - 1, 0, len(step) - 1)
        x = np.clip(time_s, 0.0, t[-1]) - t[k]
        slope = rise[k] / step[k]
        beyond = np.maximum(time_s - t[-1], 0.0)
        return (
            area[k] + x * (s[k] + x * (ds[k] / 2.0 + x * slope / 6.0)) + beyond * s[-1],
            np.where(beyond > 0.0, s[-1], s[k] + x * (ds[k] + x * slope / 2.0)),
            np.where(beyond > 0.0, ds[-1], ds[k] + x * slope),
        )
