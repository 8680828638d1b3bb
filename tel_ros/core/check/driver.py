"""Checks of how the driver carries out commands: delay, effort field, watchdog."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from tel_ros.core.check.evidence import Evidence, Finding, Pulse, Silence, Verdict, judged, unchecked
from tel_ros.core.errors import counted
from tel_ros.core.types import NS_PER_S, BoolArray, FloatArray

DELAY_PERIODS = 2.5
DELAY_S = 0.01
"""A delay of so many periods or seconds, whichever is more, is fine."""
WATCHDOG_S = 0.1
SHORT_WATCHDOG_S = 0.02
SHORT_WATCHDOG_PERIODS = 5.0
"""A watchdog of this time, or of so many periods where they are more, also stops commands that stutter."""
QUANTUM_SHARE = 0.005
"""Share of the effort limit up to which steps of the effort are fine."""
FOLLOWS = 2.0
"""Factor by which the effort field may differ from what was commanded."""
_LONGEST_S = 0.06
_UNLIKE = "it is not in N·m at the joint, belongs to another joint, is filtered, or the channel is dead"


def delay(seen: Evidence) -> Iterator[Finding]:
    """A state that shows the effect of a command on the motion comes soon after the command."""
    limit_s = max(DELAY_PERIODS / seen.rate_hz, DELAY_S)
    expected = f"up to {limit_s * 1e3:g} ms ({limit_s * seen.rate_hz:g} periods)"
    delays = [motion_delay_s(pulse, seen.pulsed.visible_rad) for pulse in seen.pulsed.pulses]
    known = [delay for delay in delays if delay is not None]
    if not known:
        yield unchecked("no joint moved", expected)
        return
    delay_s = float(np.median(known))
    spread = f"{min(known) * 1e3:.1f} to {max(known) * 1e3:.1f} ms"
    measured = f"{delay_s * 1e3:.1f} ms (median of {counted(len(known), 'pulse')}, {spread})"
    mend = (
        "look for filters and queues in the driver, the bus cycle and the network; command from the arm's "
        "own machine"
    )
    yield judged(delay_s <= limit_s, measured, expected, mend)


def motion_delay_s(pulse: Pulse, visible_rad: FloatArray) -> float | None:
    """Return how late an arm follows a pulse, or None if the motion does not show it.

    The effort that was sent, integrated twice, is the motion of an inertia; integrated once more, that of a
    small viscous friction. Their combination is fitted to the motion for one delay after the other; the best
    one counts. The joint is used that has gone furthest, relative to the motion that can be seen.
    """
    went_rad = np.abs(pulse.displacement_rad()) / visible_rad
    j = int(np.argmax(went_rad))
    time_s, position = pulse.states.received_s, pulse.states.position_rad[:, j]
    if went_rad[j] < 1.0 or len(time_s) < 10:
        return None
    delays_s = np.arange(-0.2 * _LONGEST_S, _LONGEST_S, 5e-4)
    errors = [_misfit(pulse, time_s - delay_s, position) for delay_s in delays_s]
    return float(delays_s[int(np.argmin(errors))])


def _misfit(pulse: Pulse, time_s: FloatArray, position_rad: FloatArray) -> float:
    """Return the squared error of the best motion with the pulse's shape at these times."""
    twice, thrice = np.zeros_like(time_s), np.zeros_like(time_s)
    for at_s, change in ((pulse.start_s, 1.0), (pulse.turn_s, -2.0), (pulse.zero_s, 1.0)):
        since_s = np.maximum(time_s - at_s, 0.0)
        twice += change * since_s**2 / 2.0
        thrice += change * since_s**3 / 6.0
    # In units of the pulse's own length, so that all columns are of one size.
    length_s = pulse.zero_s - pulse.start_s
    columns = np.column_stack([np.ones_like(time_s), twice / length_s**2, thrice / length_s**3])
    solution = np.linalg.lstsq(columns, position_rad, rcond=None)[0]
    return float(np.sum((columns @ solution - position_rad) ** 2))


def effort_field(seen: Evidence) -> Iterator[Finding]:
    """The effort in the joint states has the sign and scale of the command."""
    expected = f"{1 / FOLLOWS:g} to {FOLLOWS:g} times the command"
    for j, joint in enumerate(seen.arm.joints):
        own = seen.pulsed.of(j)
        gain = effort_gain(own, j)
        if gain is None:
            if own:
                yield unchecked("none is sent", expected, joint=joint)
            continue
        mend, otherwise = "its sign is flipped against the command", Verdict.WRONG
        if gain >= -1.0 / FOLLOWS:
            mend, otherwise = _UNLIKE, Verdict.WARNING
        good = 1.0 / FOLLOWS <= gain <= FOLLOWS
        yield judged(good, f"{gain:.3g} times the command", expected, mend, joint=joint, otherwise=otherwise)


def effort_gain(pulses: Sequence[Pulse], joint: int) -> float | None:
    """Return the slope of the effort field on the commanded effort over the pulses of a joint.

    Positive and negative halves are compared, so that a constant offset (gravity, a sensor's bias) drops out.
    The field may be late by a quarter of a half. None without efforts.
    """
    gains = []
    for pulse in pulses:
        states = pulse.states
        first_s, second_s = pulse.turn_s - pulse.start_s, pulse.zero_s - pulse.turn_s
        if not np.isfinite(states.effort_nm[:, joint]).all():
            continue
        first = states.between(pulse.start_s + 0.4 * first_s, pulse.turn_s + 0.1 * first_s)
        second = states.between(pulse.turn_s + 0.4 * second_s, pulse.zero_s + 0.1 * second_s)
        if len(first) and len(second):
            difference = np.median(first.effort_nm[:, joint]) - np.median(second.effort_nm[:, joint])
            gains.append(float(difference) / (2.0 * pulse.effort_nm))
    return float(np.median(gains)) if gains else None


def effort_steps(seen: Evidence) -> Iterator[Finding]:
    """The effort field has fine steps."""
    for j, joint in enumerate(seen.arm.joints):
        limit_nm = QUANTUM_SHARE * seen.arm.effort_limit_nm[j]
        column = seen.moved.effort_nm[:, j]
        values = np.unique(column[np.isfinite(column)])
        steps = np.diff(values)
        steps = steps[steps > 1e-12]
        expected = f"steps of up to {limit_nm:.3g} N·m ({QUANTUM_SHARE:.1%} of the limit)"
        if not len(steps):
            text = "the effort field has not changed" if len(values) else "none is sent"
            yield unchecked(text, expected, joint=joint)
            continue
        step_nm = float(steps.min())
        mend = "small corrections are lost between such steps: a finer command interface, or less gear"
        good, otherwise = step_nm <= limit_nm, Verdict.WARNING
        yield judged(good, f"{step_nm:.3g} N·m", expected, mend, joint=joint, otherwise=otherwise)


def watchdog(seen: Evidence) -> Iterator[Finding]:
    """The effort goes to zero by itself after the last command.

    Judged by the effort field where it shows the command, else by the motion: with effort the joint goes on
    gaining speed.
    """
    silence, rate_hz = seen.pulsed.silence, seen.rate_hz
    expected = f"zero effort within {WATCHDOG_S * 1e3:g} ms after the last command"
    mend = (
        "a driver must switch the effort off when commands stop: stock effort controllers do not, they hold "
        "the last command for ever. Give the hardware interface a time-out; else a crash leaves effort on"
    )
    if silence is None:
        yield unchecked("not tried: it needs a joint that moves when it is pushed", expected)
        return
    # Two periods for the way there and back.
    allowed_s = WATCHDOG_S + 2.0 / rate_hz + 0.005
    acted_s = _acted_s(silence)
    if acted_s is None:
        before, after = _accelerations(silence, allowed_s)
        if not np.isfinite(before + after) or before == 0.0:
            yield unchecked("the motion does not show it", expected)
            return
        left = f"{after / before:.0%} of the acceleration is left after {allowed_s * 1e3:.0f} ms"
        yield judged(after / before < 0.5, f"{left} (no effort field)", expected, mend)
        return
    measured = f"effort until {max(acted_s, 0.0) * 1e3:.0f} ms after the last command"
    if acted_s > allowed_s:
        yield judged(False, measured, expected, mend)
        return
    short_s = max(SHORT_WATCHDOG_S, SHORT_WATCHDOG_PERIODS / rate_hz)
    yield judged(
        acted_s <= allowed_s - WATCHDOG_S + short_s,
        measured,
        f"{expected}, better within {short_s * 1e3:g} ms",
        "shorten the driver's time-out: commands that come one at a time, 20 to 90 ms apart, can drive an "
        "arm wild within the longest one",
        otherwise=Verdict.WARNING,
    )


def _acted_s(silence: Silence) -> float | None:
    """Return how long after the last command the effort field shows it; None if it never does."""
    states = silence.states
    effort = states.effort_nm[:, silence.joint]
    pushing = states.received_s <= silence.silent_s
    acting = np.abs(effort) > 0.5 * silence.effort_nm
    if not np.isfinite(effort).all() or not np.any(acting & pushing):
        return None
    # By the arm's time: a simulated arm on a busy machine is slower than our clock.
    last = int(np.flatnonzero(acting)[-1])
    return float(states.stamp_ns[last] - states.stamp_ns[pushing][-1]) / NS_PER_S


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
