"""Checks of how the driver carries out commands: delay, effort field, watchdog."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tel_ros.core.check.evidence import Evidence, Finding, Pulse, Silence, Verdict, judged, unchecked
from tel_ros.core.check.response import unsound
from tel_ros.core.errors import counted
from tel_ros.core.types import NS_PER_S, BoolArray, FloatArray

DELAY_PERIODS = 2.5
DELAY_S = 0.01
"""A delay of so many periods or seconds, whichever is more, is fine."""
WATCHDOG_S = 0.1
SHORT_WATCHDOG_S = 0.02
SHORT_WATCHDOG_PERIODS = 5.0
"""A watchdog of this time, or of so many periods where they are more, also stops commands that stutter."""
DELAY_ERROR_S = 0.005
"""The motion tells the delay to within about 2 ms; one that is further below zero is no figure."""
QUANTUM_SHARE = 0.005
"""Share of the effort limit up to which steps of the effort are fine."""
FOLLOWS = 2.0
"""Factor by which the effort field may differ from what was commanded."""
_LONGEST_S = 0.06
_UNLIKE = "it is not in N·m at the joint, belongs to another joint, is filtered, or the channel is dead"


def delay(seen: Evidence) -> Finding:
    """A state that shows the effect of a command comes soon after the command.

    Joints that do not answer their own command are left out. The effort field tells where it follows the
    command; the motion tells how late the drive itself is, as far as all pulses agree on it.
    """
    limit_s = max(DELAY_PERIODS / seen.rate_hz, DELAY_S)
    expected = f"up to {limit_s * 1e3:g} ms ({limit_s * seen.rate_hz:g} periods)"
    mend = (
        "look for filters and queues in the driver, the bus cycle and the network; command from the arm's "
        "own machine"
    )
    pulsed = seen.pulsed
    sound = [pulse for pulse in pulsed.pulses if not unsound(pulsed, pulse.joint, seen.arm.joints)]
    told = [s for p in sound if follows(pulsed.effort_gain(p.joint)) for s in effort_delays_s(p)]
    moved = [s for p in sound if (s := motion_delay_s(p, pulsed.visible_rad[p.joint])) is not None]
    apart_s = np.ptp(moved) if moved else 0.0
    late = bool(moved) and min(moved) > limit_s
    by_field = f"{_figure(told)} by the effort field" if told else ""
    if told and not late:
        return judged(float(np.median(told)) <= limit_s, by_field, expected, mend)
    if moved and (late or (apart_s <= limit_s and min(moved) >= -DELAY_ERROR_S)):
        by_motion = f"{_figure(np.maximum(moved, 0.0))} by the motion, give or take 2 ms"
        measured = f"{by_motion}, {by_field}" if told else by_motion
        return judged(float(np.median(moved)) <= limit_s, measured, expected, mend)
    if moved:
        apart = f"delays that are {apart_s * 1e3:.0f} ms apart" if apart_s > limit_s else "no possible delay"
        by_motion = f"the motion of {counted(len(moved), 'pulse')} gives {apart} (dry friction?)"
        return unchecked(by_motion, expected)
    return unchecked("no joint has clearly answered its own command", expected)


def _figure(delays_s: Sequence[float] | FloatArray) -> str:
    """Return the median and the spread of delays in words."""
    low, middle, high = 1e3 * np.percentile(delays_s, [0, 50, 100])
    return f"{middle:.1f} ms ({low:.1f} to {high:.1f} ms in {counted(len(delays_s), 'case')})"


def follows(gain: float) -> bool:
    """Return whether the effort field follows the command; not if it is not known (NaN)."""
    return 1.0 / FOLLOWS <= gain <= FOLLOWS


def effort_delays_s(pulse: Pulse) -> list[float]:
    """Return how late the effort field of a joint shows each change of its command."""
    time_s, before = pulse.states.received_s, pulse.states.received_s <= pulse.start_s
    effort = pulse.states.effort_nm[:, pulse.joint]
    offset_nm = np.median(effort[before]) if np.any(before) else 0.0
    told = (effort - offset_nm) / (pulse.effort_gain * pulse.effort_nm)
    delays_s, k = [], 0
    changes = ((pulse.start_s, 0.5, 1.0), (pulse.turn_s, 0.0, -1.0), (pulse.zero_s, -0.5, 1.0))
    for at_s, half_way, way in changes:
        shown = np.flatnonzero((time_s[k:] > at_s) & (way * (told[k:] - half_way) > 0.0))
        if not len(shown):
            break
        k += int(shown[0])
        delays_s.append(float(time_s[k] - at_s))
    return delays_s


def motion_delay_s(pulse: Pulse, visible_rad: float) -> float | None:
    """Return how late a joint follows its pulse, or None if its motion does not show it.

    The effort that was sent, integrated twice, is the motion of an inertia; integrated once more, that of a
    small viscous friction. Their combination is fitted to the motion for one delay after the other; the best
    one counts.
    """
    time_s, position = pulse.states.received_s, pulse.states.position_rad[:, pulse.joint]
    if abs(pulse.reach_rad[pulse.joint]) < visible_rad or len(time_s) < 10:
        return None

    def misfit(delay_s: float) -> float:
        since_s = np.maximum(time_s[:, None] - delay_s - [pulse.start_s, pulse.turn_s, pulse.zero_s], 0.0)
        # In units of the pulse's own length, so that all columns are of one size.
        powers = [(since_s / (pulse.zero_s - pulse.start_s)) ** n @ [1.0, -2.0, 1.0] for n in (2, 3)]
        columns = np.column_stack([np.ones_like(time_s), *powers])
        solution = np.linalg.lstsq(columns, position, rcond=None)[0]
        return float(np.sum((columns @ solution - position) ** 2))

    return float(min(np.arange(-0.2 * _LONGEST_S, _LONGEST_S, 5e-4), key=misfit))


def effort_field(seen: Evidence, j: int) -> Finding:
    """The effort in the joint states has the sign and scale of the command."""
    expected, gain = f"{1 / FOLLOWS:g} to {FOLLOWS:g} times the command", seen.pulsed.effort_gain(j)
    if np.isnan(gain):
        none = "none is sent" if seen.pulsed.of(j) else unsound(seen.pulsed, j, seen.arm.joints)
        return unchecked(none, expected)
    mend, otherwise = _UNLIKE, Verdict.WARNING
    if gain < -1.0 / FOLLOWS:
        mend, otherwise = "its sign is flipped against the command", Verdict.WRONG
    return judged(follows(gain), f"{gain:.3g} times the command", expected, mend, otherwise)


def effort_steps(seen: Evidence, j: int) -> Finding:
    """The effort field has fine steps."""
    limit_nm = QUANTUM_SHARE * seen.arm.effort_limit_nm[j]
    values = np.unique(seen.moving.effort_nm[:, j])
    values = values[np.isfinite(values)]
    steps = np.diff(values)
    steps = steps[steps > 1e-12]
    expected = f"steps of up to {limit_nm:.3g} N·m ({QUANTUM_SHARE:.1%} of the limit)"
    if not len(steps):
        return unchecked("the effort field has not changed" if len(values) else "none is sent", expected)
    mend = "small corrections are lost between such steps: a finer command interface, or less gear"
    return judged(steps.min() <= limit_nm, f"{steps.min():.3g} N·m", expected, mend, Verdict.WARNING)


def watchdog(seen: Evidence) -> Finding:
    """The effort goes to zero by itself after the last command.

    Judged by the effort field where it follows the command, else by the motion: with effort the joint goes on
    gaining speed.
    """
    silence, rate_hz = seen.pulsed.silence, seen.rate_hz
    expected = f"zero effort within {WATCHDOG_S * 1e3:g} ms after the last command"
    if silence is None:
        early, none = "the pulses ended early", "no joint answers its own command clearly"
        return unchecked(early if seen.pulsed.complaint else none, expected)
    mend = (
        "a driver must switch the effort off when commands stop: stock effort controllers do not, they hold "
        "the last command for ever. Give the hardware interface a time-out; else a crash leaves effort on"
    )
    # Two periods for the way there and back.
    allowed_s = WATCHDOG_S + 2.0 / rate_hz + 0.005
    gain = seen.pulsed.effort_gain(silence.joint)
    acted_s = _acted_s(silence, gain) if follows(gain) else None
    if acted_s is None:
        (before, error), (after, late_error) = _accelerations(silence, allowed_s, seen.pulsed.resolution_rad)
        if not (abs(before) > 4.0 * error and late_error < 0.25 * abs(before)):  # also if NaN
            return unchecked("the joint goes too little to show it, and the effort field does not", expected)
        left = f"{max(after / before, 0.0):.0%} of the acceleration is left after {allowed_s * 1e3:.0f} ms"
        return judged(after / before < 0.5, f"{left} (by the motion)", expected, mend)
    measured = f"effort until {max(acted_s, 0.0) * 1e3:.0f} ms after the last command"
    if acted_s > allowed_s:
        return judged(False, measured, expected, mend)
    short_s = max(SHORT_WATCHDOG_S, SHORT_WATCHDOG_PERIODS / rate_hz)
    mend = (
        "shorten the driver's time-out: commands that come one at a time, 20 to 90 ms apart, can drive an "
        "arm wild within the longest one"
    )
    expected = f"{expected}, better within {short_s * 1e3:g} ms"
    return judged(acted_s <= allowed_s - WATCHDOG_S + short_s, measured, expected, mend, Verdict.WARNING)


def _acted_s(silence: Silence, gain: float) -> float | None:
    """Return how long after the last command the effort field shows it; None if it never does."""
    states = silence.states
    before, pushing = states.received_s <= silence.start_s, states.received_s <= silence.silent_s
    effort = states.effort_nm[:, silence.joint]
    offset_nm = np.median(effort[before]) if np.any(before) else 0.0
    acting = np.abs(effort - offset_nm) > 0.5 * gain * silence.effort_nm
    if not np.any(acting & pushing):
        return None
    # By the arm's time: a simulated arm on a busy machine is slower than our clock.
    last = int(np.flatnonzero(acting)[-1])
    return float(states.stamp_ns[last] - states.stamp_ns[pushing][-1]) / NS_PER_S


def _accelerations(
    silence: Silence, allowed_s: float, resolution_rad: FloatArray
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the acceleration before the effort may go, and after it has to be gone, with their errors."""
    time_s = silence.states.received_s - silence.silent_s
    position = silence.states.position_rad[:, silence.joint]

    def fitted(rows: BoolArray) -> tuple[float, float]:
        if np.sum(rows) < 5:
            return float("nan"), float("nan")
        fit, unit = np.polyfit(time_s[rows], position[rows], 2, cov="unscaled")
        apart_rad = float(np.std(np.polyval(fit, time_s[rows]) - position[rows]))
        noise_rad = max(apart_rad, float(resolution_rad[silence.joint]) / 12**0.5)
        return float(2.0 * fit[0]), float(2.0 * noise_rad * unit[0, 0] ** 0.5)

    # The watchdog may act at any time between: what counts before is the push itself.
    pushed = (time_s >= silence.start_s - silence.silent_s) & (time_s <= 0.01)
    return fitted(pushed), fitted(time_s >= allowed_s)
