"""Does the effort in the joint states tell what was commanded, and in which steps?"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tel_ros.core.check.findings import Finding, Verdict, judged
from tel_ros.core.check.records import Pulse, Silence, StateRecord
from tel_ros.core.config import ArmConfig
from tel_ros.core.types import NS_PER_S, BoolArray

WATCHDOG_S = 0.1
SHORT_WATCHDOG_S = 0.02
SHORT_WATCHDOG_PERIODS = 5.0
"""A watchdog of this time, or of so many periods where they are more, also stops commands that stutter."""
QUANTUM_SHARE = 0.005
"""Share of the effort limit up to which steps of the effort are fine."""
FOLLOWS = 2.0
"""Factor by which the effort field may differ from what was commanded."""


def effort_gain(pulses: Sequence[Pulse], joint: int) -> float | None:
    """Return the slope of the effort field on the commanded effort over pulses of a joint.

    Positive and negative halves are compared, so that a constant offset (gravity, a sensor's bias) drops out.
    The field may be late by a quarter of a half. None without efforts.
    """
    gains = []
    for pulse in pulses:
        states = pulse.states
        first_s, second_s = pulse.turn_s - pulse.start_s, pulse.zero_s - pulse.turn_s
        if pulse.joint != joint or not np.isfinite(states.effort_nm[:, joint]).all():
            continue
        first = states.between(pulse.start_s + 0.4 * first_s, pulse.turn_s + 0.1 * first_s)
        second = states.between(pulse.turn_s + 0.4 * second_s, pulse.zero_s + 0.1 * second_s)
        if len(first) and len(second):
            difference = np.median(first.effort_nm[:, joint]) - np.median(second.effort_nm[:, joint])
            gains.append(float(difference) / (2.0 * pulse.effort_nm))
    return float(np.median(gains)) if gains else None


def judge_effort_field(pulses: Sequence[Pulse], joints: Sequence[str]) -> list[Finding]:
    """Judge sign and scale of the effort in the joint states."""
    expected = f"{1 / FOLLOWS:g} to {FOLLOWS:g} times the command"
    findings = []
    for j, joint in enumerate(joints):
        gain = effort_gain(pulses, j)
        if gain is None:
            findings.append(Finding("effort field", Verdict.NOT_CHECKED, "none is sent", expected, "", joint))
            continue
        flipped = gain < -1.0 / FOLLOWS
        findings.append(
            judged(
                "effort field",
                1.0 / FOLLOWS <= gain <= FOLLOWS,
                f"{gain:.3g} times the command",
                expected,
                "its sign is flipped against the command"
                if flipped
                else "it is no N·m at the joint, belongs to another joint, is filtered for long, or the "
                "channel is dead",
                joint=joint,
                otherwise=Verdict.WRONG if flipped else Verdict.WARNING,
            )
        )
    return findings


def judge_quantisation(states: StateRecord, arm: ArmConfig) -> list[Finding]:
    """Judge the smallest step of the effort field that was seen."""
    findings = []
    for j, joint in enumerate(states.joints):
        limit_nm = QUANTUM_SHARE * arm.effort_limit_nm[j]
        values = np.unique(states.effort_nm[np.isfinite(states.effort_nm[:, j]), j])
        steps = np.diff(values)
        steps = steps[steps > 1e-12]
        expected = f"steps of up to {limit_nm:.3g} N·m ({QUANTUM_SHARE:.1%} of the limit)"
        if not len(steps):
            text = "the effort field has not changed" if len(values) else "none is sent"
            findings.append(Finding("effort steps", Verdict.NOT_CHECKED, text, expected, "", joint))
            continue
        step_nm = float(steps.min())
        findings.append(
            judged(
                "effort steps",
                step_nm <= limit_nm,
                f"{step_nm:.3g} N·m",
                expected,
                "small corrections are lost between such steps: a finer command interface, or less gear",
                joint=joint,
                otherwise=Verdict.WARNING,
            )
        )
    return findings


def judge_watchdog(silence: Silence | None, rate_hz: float) -> Finding:
    """Judge whether the effort has gone to zero by itself after the last command.

    By the effort field where it shows the command, else by the motion: with effort the joint goes on gaining
    speed.
    """
    expected = f"zero effort within {WATCHDOG_S * 1e3:g} ms after the last command"
    mend = (
        "a driver must switch the effort off when commands stop: stock effort controllers do not, they hold "
        "the last command for ever. Give the hardware interface a time-out; else a crash leaves effort on"
    )
    if silence is None:
        text = "not tried: it needs a joint that moves when it is pushed"
        return Finding("watchdog of the driver", Verdict.NOT_CHECKED, text, expected)
    # Two periods for the way there and back.
    allowed_s = WATCHDOG_S + 2.0 / rate_hz + 0.005
    states = silence.states
    effort = states.effort_nm[:, silence.joint]
    pushing = states.received_s <= silence.silent_s
    if np.isfinite(effort).all() and np.max(np.abs(effort[pushing]), initial=0.0) > 0.5 * silence.effort_nm:
        acting = np.abs(effort) > 0.5 * silence.effort_nm
        # By the arm's time: a simulated arm on a busy machine is slower than our clock.
        last = int(np.flatnonzero(acting)[-1])
        last_s = float(states.stamp_ns[last] - states.stamp_ns[pushing][-1]) / NS_PER_S
        measured = f"effort until {max(last_s, 0.0) * 1e3:.0f} ms after the last command"
        if last_s > allowed_s:
            return judged("watchdog of the driver", False, measured, expected, mend)
        short_s = max(SHORT_WATCHDOG_S, SHORT_WATCHDOG_PERIODS / rate_hz)
        return judged(
            "watchdog of the driver",
            last_s <= allowed_s - WATCHDOG_S + short_s,
            measured,
            f"{expected}, better within {short_s * 1e3:g} ms",
            "shorten the driver's time-out: commands that come one at a time, 20 to 90 ms apart, can drive "
            "an arm wild within the longest one",
            otherwise=Verdict.WARNING,
        )
    before, after = _accelerations(silence, allowed_s)
    if not np.isfinite(before + after) or before == 0.0:
        text = "the motion does not tell"
        return Finding("watchdog of the driver", Verdict.NOT_CHECKED, text, expected)
    share = after / before
    return judged(
        "watchdog of the driver",
        share < 0.5,
        f"{share:.0%} of the acceleration is left after {allowed_s * 1e3:.0f} ms (no effort field)",
        expected,
        mend,
    )


def _accelerations(silence: Silence, allowed_s: float) -> tuple[float, float]:
    """Return the acceleration before the effort may go, and after it has to be gone."""
    time_s = silence.states.received_s - silence.silent_s
    position = silence.states.position_rad[:, silence.joint]

    def fitted(rows: BoolArray) -> float:
        if np.sum(rows) < 5:
            return float("nan")
        return float(2.0 * np.polyfit(time_s[rows], position[rows], 2)[0])

    # The watchdog may act at any time between: what counts before is the push itself.
    return fitted(time_s <= 0.01), fitted(time_s >= allowed_s)
