"""What can be judged without sending anything: rate, jitter, stamps, age, values, postures."""

from __future__ import annotations

import numpy as np

from tel_ros.core.check.findings import Finding, Verdict, judged
from tel_ros.core.check.records import StateRecord
from tel_ros.core.config import ArmConfig
from tel_ros.core.types import NS_PER_S, FloatArray

RATE_TOLERANCE = 0.1
"""Share by which the rate may differ from the configured one."""
JITTER_PERIODS = 3.0
AGE_LIMIT_S = 0.02
CLOCK_TOLERANCE_S = 0.005
"""How far a stamp may lie in the future: clocks of two machines agree only so far."""


def judge_rate(states: StateRecord, rate_hz: float) -> list[Finding]:
    """Judge how many states arrive, by our clock and by their stamps, and how evenly."""
    arrived_hz = _rate_hz(states.received_s)
    stamps_s = _distinct_stamps_s(states)
    stamped_hz = _rate_hz(stamps_s)
    expected = f"{rate_hz:g} Hz within {RATE_TOLERANCE:.0%}"
    findings = [
        judged(
            "rate of states",
            abs(arrived_hz / rate_hz - 1.0) <= RATE_TOLERANCE,
            f"{arrived_hz:.1f} Hz",
            expected,
            "set control.rate_hz to the rate of the joint states, or update_rate of the controller manager "
            "to control.rate_hz; a busy machine loses states as well",
        ),
        judged(
            "rate of stamps",
            abs(stamped_hz / rate_hz - 1.0) <= RATE_TOLERANCE,
            f"{stamped_hz:.1f} Hz",
            expected,
            "every state needs the time of its own measurement as stamp",
        ),
    ]
    if len(states) > 2:
        late_s = np.diff(states.received_s) - 1.0 / rate_hz
        p99_s = float(np.percentile(np.abs(late_s), 99))
        limit_s = JITTER_PERIODS / rate_hz
        measured = (
            f"99 % within {p99_s * 1e3:.2f} ms, longest gap {(late_s.max() + 1 / rate_hz) * 1e3:.1f} ms"
        )
        mend = "look for other work on this machine and in the driver's loop; a real-time kernel helps"
        findings.append(
            judged(
                "jitter of arrival",
                p99_s <= limit_s,
                measured,
                f"99 % within {limit_s * 1e3:.1f} ms",
                mend,
                otherwise=Verdict.WARNING,
            )
        )
    return findings


def judge_stamps(states: StateRecord) -> Finding:
    """Judge whether time goes forward from state to state."""
    steps = np.diff(states.stamp_ns)
    back, same = int(np.sum(steps < 0)), int(np.sum(steps == 0))
    return judged(
        "order of stamps",
        back == same == 0 and len(steps) > 0,
        f"{back} of {len(steps)} steps go back, {same} repeat a stamp",
        "each state newer than the one before",
        "look for a second or stale publisher of joint states, and for a driver that repeats old readings",
        blocks=True,
    )


def judge_age(states: StateRecord, *, arm_has_own_clock: bool) -> Finding:
    """Judge how old states are when they arrive.

    Args:
        states: as they arrived.
        arm_has_own_clock: stamps count the arm's own time (as a simulated arm's do) and say nothing of age.
    """
    age_s = float(np.median(states.age_s))
    expected = f"{-CLOCK_TOLERANCE_S * 1e3:g} to {AGE_LIMIT_S * 1e3:g} ms"
    if arm_has_own_clock:
        return Finding("age of states", Verdict.NOT_CHECKED, "the stamps are the arm's own time", expected)
    mend = "look for a stale publisher, buffers and a slow network"
    if age_s < -CLOCK_TOLERANCE_S or age_s > 1.0:
        mend = "synchronise the clocks of both machines (chrony, PTP), or look for a stale publisher"
    return judged(
        "age of states",
        -CLOCK_TOLERANCE_S <= age_s <= AGE_LIMIT_S,
        f"{age_s * 1e3:.1f} ms, at most {states.age_s.max() * 1e3:.1f} ms",
        expected,
        mend,
        blocks=True,
    )


def judge_values(states: StateRecord) -> list[Finding]:
    """Judge which fields arrive, and whether positions are numbers."""
    findings = []
    bad = _not_finite(states.joints, states.position_rad)
    findings.append(
        judged(
            "positions",
            not bad,
            f"not finite: {', '.join(bad)}" if bad else "finite",
            "finite numbers of rad",
            "the driver has to send a number for each joint, or nothing at all while it has none",
            blocks=True,
        )
    )
    for name, values, mend in (
        ("velocities", states.velocity_rad_s, "they are then estimated from positions, which adds delay"),
        ("efforts", states.effort_nm, "then a dead channel and the watchdog are told from motion alone"),
    ):
        missing = _not_finite(states.joints, values)
        measured = f"missing: {', '.join(missing)}" if missing else "sent"
        findings.append(
            judged(name, not missing, measured, "sent for each joint", mend, otherwise=Verdict.WARNING)
        )
    return findings


def judge_posture(states: StateRecord, arm: ArmConfig) -> list[Finding]:
    """Judge whether the arm is inside its joint range. The limits of ``arm`` have been filled."""
    findings = []
    low, high = states.position_rad.min(axis=0), states.position_rad.max(axis=0)
    for j, joint in enumerate(states.joints):
        lowest, highest = arm.position_min_rad[j], arm.position_max_rad[j]
        findings.append(
            judged(
                "posture",
                lowest <= low[j] and high[j] <= highest,
                f"{low[j]:.4g} to {high[j]:.4g} rad",
                f"{lowest:.4g} to {highest:.4g} rad",
                "are the positions degrees instead of radians? Else: the encoder's zero, "
                "arm.position_min_rad and position_max_rad, or move the joint back into its range by hand",
                joint=joint,
                blocks=True,
            )
        )
    return findings


def _not_finite(joints: tuple[str, ...], values: FloatArray) -> list[str]:
    return [joint for j, joint in enumerate(joints) if not np.isfinite(values[:, j]).all()]


def _distinct_stamps_s(states: StateRecord) -> np.ndarray:
    stamps = states.stamp_ns[np.flatnonzero(np.diff(states.stamp_ns, prepend=states.stamp_ns[:1] - 1))]
    return np.asarray((stamps - stamps[0]) / NS_PER_S if len(stamps) else stamps, dtype=np.float64)


def _rate_hz(times_s: np.ndarray) -> float:
    span_s = float(times_s[-1] - times_s[0]) if len(times_s) > 1 else 0.0
    return (len(times_s) - 1) / span_s if span_s > 0.0 else 0.0
