"""Do measured velocities belong to the measured positions?"""

from __future__ import annotations

import math

import numpy as np

from tel_ros.core.check.findings import Finding, Verdict, judged
from tel_ros.core.check.records import StateRecord
from tel_ros.core.types import NS_PER_S, FloatArray, IntArray

WINDOW_S = 0.05
"""Velocities are compared over windows of this length: a filter that is late by less hardly matters."""
ENOUGH_WINDOWS = 3
"""That do not overlap, in which a joint has to have moved clearly."""
TOLERANCE = 0.25
_DEGREES = math.degrees(1.0)
_STILL = ("the joint has hardly moved", "move it by hand while this listens, or let it be pulsed")


def judge_velocity(states: StateRecord) -> list[Finding]:
    """Compare the velocity, summed up over short windows, with how far the joint went in them.

    Windows in which a joint has not gone clearly further than its position can tell are left out. The ratio
    is the least-squares slope over all others, so that velocity = ratio × differentiated position.
    """
    expected = f"{1 - TOLERANCE:g} to {1 + TOLERANCE:g} times the differentiated position"
    resolution = states.resolution_rad()
    findings = []
    first, last = _windows(states.stamp_ns)
    for j, joint in enumerate(states.joints):
        position, velocity = states.position_rad[:, j], states.velocity_rad_s[:, j]
        if not np.isfinite(velocity).all():
            text = "no velocity is sent"
            findings.append(Finding("velocity", Verdict.NOT_CHECKED, text, expected, "", joint))
            continue
        sums = _integral(states.stamp_ns, velocity)
        went, summed = position[last] - position[first], sums[last] - sums[first]
        clear_rad = max(8.0 * resolution[j], 1e-4)
        clear = np.abs(went) > clear_rad
        n_apart = _n_apart(first[clear], last[clear])
        if n_apart < ENOUGH_WINDOWS:
            moved = float(np.ptp(position)) > ENOUGH_WINDOWS * clear_rad
            text, mend = _too_little(n_apart) if moved else _STILL
            findings.append(Finding("velocity", Verdict.NOT_CHECKED, text, expected, mend, joint))
            continue
        ratio = float(went[clear] @ summed[clear] / (went[clear] @ went[clear]))
        findings.append(
            judged(
                "velocity",
                abs(ratio - 1.0) <= TOLERANCE,
                f"{ratio:.3g} times the differentiated position",
                expected,
                _mend(ratio),
                joint=joint,
            )
        )
    return findings


def _too_little(n_windows: int) -> tuple[str, str]:
    """Return what is said of a joint that has moved, but not while enough was heard of it, and what helps."""
    text = f"{n_windows} times {WINDOW_S * 1e3:g} ms of clear motion, at least {ENOUGH_WINDOWS} are needed"
    return text, "check once more; are states missing (see rate and jitter)? Else move it by hand for longer"


def _mend(ratio: float) -> str:
    if 0.5 * _DEGREES < abs(ratio) < 2.0 * _DEGREES:
        return "the velocity is in degrees/s: convert it to rad/s in the driver"
    if 0.5 / _DEGREES < abs(ratio) < 2.0 / _DEGREES:
        return "the position is in degrees and the velocity in rad/s: convert the position in the driver"
    if ratio < 0.0:
        return "the velocity's sign is flipped against the position's"
    return "position and velocity need the same unit (rad, rad/s), gear ratio and joint"


def _integral(stamp_ns: IntArray, velocity: FloatArray) -> FloatArray:
    """Return the velocity summed up since the first state; shape (n,)."""
    steps = 0.5 * (velocity[1:] + velocity[:-1]) * np.diff(stamp_ns) / NS_PER_S
    return np.concatenate([[0.0], np.cumsum(steps)])


def _windows(stamp_ns: IntArray) -> tuple[IntArray, IntArray]:
    """Return the first and the last state of windows, one from each state on; shape (n_windows,) each."""
    time_s = (stamp_ns - stamp_ns[0]) / NS_PER_S
    steps_s = np.diff(time_s)
    # A gap is in no window: nobody knows what the velocity was in it.
    gaps = np.flatnonzero((steps_s > WINDOW_S) | (steps_s <= 0.0)) + 1
    first, last = [], []
    for piece in np.split(np.arange(len(time_s)), gaps):
        # The tolerance keeps rounding of equal periods from adding one.
        ends = piece[0] + np.searchsorted(time_s[piece], time_s[piece] + WINDOW_S - 1e-6)
        whole = ends <= piece[-1]
        first.append(piece[whole])
        last.append(ends[whole])
    return np.concatenate(first), np.concatenate(last)


def _n_apart(first: IntArray, last: IntArray) -> int:
    """Return how many windows there are that do not overlap."""
    n = free = 0
    for begin, end in zip(first, last, strict=True):
        if begin >= free:
            n, free = n + 1, end
    return n
