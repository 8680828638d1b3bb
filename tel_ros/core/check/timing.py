"""How long it takes from a command to the state that shows its effect."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tel_ros.core.check.findings import Finding, Verdict, judged
from tel_ros.core.check.records import Pulse
from tel_ros.core.types import FloatArray

DELAY_PERIODS = 2.5
DELAY_S = 0.01
"""A delay of so many periods or seconds, whichever is more, is fine."""
_STEP_S = 5e-4
_LONGEST_S = 0.06


def motion_delay_s(pulse: Pulse, visible_rad: FloatArray) -> float | None:
    """Return how late an arm follows a pulse, or None if it cannot be told.

    The effort that was sent, integrated twice, is the motion of an inertia; integrated once more, that of a
    small viscous friction. Their combination is fitted to the motion for one delay after the other; the best
    one counts. The joint that has gone furthest, measured by what can be seen, is asked.

    Args:
        pulse: as it was sent.
        visible_rad: how far each joint has to go to have moved at all. Shape (n_joints,).
    """
    went_rad = np.abs(pulse.displacement_rad()) / visible_rad
    j = int(np.argmax(went_rad))
    states = pulse.states
    if went_rad[j] < 1.0 or len(states) < 10:
        return None
    time_s, position = states.received_s, states.position_rad[:, j]
    delays_s = np.arange(-0.2 * _LONGEST_S, _LONGEST_S, _STEP_S)
    errors = [_misfit(pulse, time_s - delay_s, position) for delay_s in delays_s]
    return float(delays_s[int(np.argmin(errors))])


def judge_delay(pulses: Sequence[Pulse], visible_rad: FloatArray, rate_hz: float) -> Finding:
    """Judge the time from sending a command to receiving a state that shows its effect on the motion."""
    limit_s = max(DELAY_PERIODS / rate_hz, DELAY_S)
    expected = f"up to {limit_s * 1e3:g} ms ({limit_s * rate_hz:g} periods)"
    delays = [motion_delay_s(pulse, visible_rad) for pulse in pulses]
    known = [delay for delay in delays if delay is not None]
    if not known:
        return Finding("round-trip delay", Verdict.NOT_CHECKED, "no joint moved", expected)
    delay_s = float(np.median(known))
    return judged(
        "round-trip delay",
        delay_s <= limit_s,
        f"{delay_s * 1e3:.1f} ms (median of {len(known)} pulses, {min(known) * 1e3:.1f} to "
        f"{max(known) * 1e3:.1f} ms)",
        expected,
        "look for filters and queues in the driver, the bus cycle and the network; command from the arm's "
        "own machine",
    )


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
