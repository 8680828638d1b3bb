"""Do measured velocities belong to the measured positions?"""

from __future__ import annotations

import math

import numpy as np

from tel_ros.core.check.findings import Finding, Verdict, judged
from tel_ros.core.check.records import StateRecord
from tel_ros.core.types import NS_PER_S

WINDOW_S = 0.05
"""Velocities are compared over windows of this length: a filter that is late by less hardly matters."""
TOLERANCE = 0.25
_DEGREES = math.degrees(1.0)


def judge_velocity(states: StateRecord) -> list[Finding]:
    """Compare the velocity, summed up over short windows, with how far the joint went in them.

    Windows in which a joint has not gone clearly further than its position can tell are left out. The ratio
    is the least-squares slope over all others, so that velocity = ratio × differentiated position.
    """
    expected = f"{1 - TOLERANCE:g} to {1 + TOLERANCE:g} times the differentiated position"
    resolution = states.resolution_rad()
    findings = []
    for j, joint in enumerate(states.joints):
        velocity = states.velocity_rad_s[:, j]
        if not np.isfinite(velocity).all():
            text = "no velocity is sent"
            findings.append(Finding("velocity", Verdict.NOT_CHECKED, text, expected, "", joint))
            continue
        went, summed = _windows(states.stamp_ns, states.position_rad[:, j], velocity)
        clear = np.abs(went) > max(8.0 * resolution[j], 1e-4)
        if np.sum(clear) < 3:
            text = "the joint has hardly moved"
            mend = "move it by hand while this listens, or let it be pulsed"
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


def _mend(ratio: float) -> str:
    if 0.5 * _DEGREES < abs(ratio) < 2.0 * _DEGREES:
        return "the velocity is in degrees/s: convert it to rad/s in the driver"
    if 0.5 / _DEGREES < abs(ratio) < 2.0 / _DEGREES:
        return "the position is in degrees and the velocity in rad/s: convert the position in the driver"
    if ratio < 0.0:
        return "the velocity's sign is flipped against the position's"
    return "position and velocity need the same unit (rad, rad/s), gear ratio and joint"


def _windows(
    stamp_ns: np.ndarray, position: np.ndarray, velocity: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return distances by position and by velocity over successive windows; shapes (n_windows,)."""
    time_s = (stamp_ns - stamp_ns[0]) / NS_PER_S
    steps_s = np.diff(time_s)
    sums = np.concatenate([[0.0], np.cumsum(0.5 * (velocity[1:] + velocity[:-1]) * steps_s)])
    edges = [0]
    for k in range(1, len(time_s)):
        # A gap is no window: nobody knows what the velocity was in it.
        if steps_s[k - 1] > WINDOW_S or steps_s[k - 1] <= 0.0:
            edges.append(-1)
            edges.append(k)
        elif time_s[k] - time_s[edges[-1]] >= WINDOW_S:
            edges.append(k)
    pairs = [(a, b) for a, b in zip(edges, edges[1:], strict=False) if a >= 0 and b >= 0]
    first, last = np.array([a for a, _ in pairs], dtype=int), np.array([b for _, b in pairs], dtype=int)
    return position[last] - position[first], sums[last] - sums[first]
