"""Checks that need no command: connections, names, rate, stamps, age, values, posture, velocity."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from tel_ros.core.check.evidence import (
    DEGREES,
    ENOUGH_STATES,
    Endpoint,
    Evidence,
    Finding,
    Verdict,
    judged,
    unchecked,
)
from tel_ros.core.errors import counted
from tel_ros.core.types import NS_PER_S, FloatArray, IntArray

RATE_TOLERANCE = 0.1
"""Share by which the rate may differ from the configured one."""
JITTER_PERIODS = 3.0
AGE_LIMIT_S = 0.02
CLOCK_TOLERANCE_S = 0.005
"""How far a stamp may lie in the future: clocks of two machines agree only so far."""
WINDOWS_S = (0.05, 0.1, 0.2)
"""Velocities are compared over windows, the shortest in which a joint moves clearly: a filter that is late by
less hardly matters."""
ENOUGH_WINDOWS = 3
"""That do not overlap, in which a joint has to have moved clearly."""
VELOCITY_TOLERANCE = 0.25


def state_publisher(seen: Evidence) -> Finding:
    """One node publishes joint states."""
    mend = "end all but one: states of two arms, or of an old process, would be mixed"
    return _one_of(seen.publishers, "sensor_msgs/msg/JointState", mend)


def command_listener(seen: Evidence) -> Finding:
    """One node takes the commands."""
    follows = seen.arm.command_interface == "trajectory"
    kind = "trajectory_msgs/msg/JointTrajectory" if follows else "std_msgs/msg/Float64MultiArray"
    mend = "start and activate the controller that takes the commands; end a second one"
    return _one_of(seen.listeners, kind, mend)


def _one_of(found: Sequence[Endpoint], kind: str, mend: str) -> Finding:
    return judged(len(found) == 1 and found[0][1] == kind, listed(found), f"one, of {kind}", mend)


def other_commanders(seen: Evidence) -> Finding:
    """Nobody else commands the arm."""
    mend = "end whoever else commands the arm (tel practice, an old ep_controller, arm_guard) first"
    return judged(not seen.commanders, listed(seen.commanders), "nobody else commands the arm", mend)


def quality_of_service(seen: Evidence) -> Finding:
    """States are published reliably."""
    unreliable = [name for name, _, reliability in seen.publishers if reliability == "best_effort"]
    found = f"best effort: {', '.join(unreliable)}" if unreliable else "reliable"
    mend = "the recorder subscribes reliably and would get nothing"
    return judged(not unreliable, found, "states are published reliably", mend)


def joint_name(seen: Evidence, j: int) -> Finding:
    """A joint of the arm is named once in every message."""
    heard = sorted(set(seen.names))
    others = sorted({name for each in heard for name in each} - set(seen.arm.joints))
    none = f"in none (others: {', '.join(others)})" if others else "in none"
    counts = tuple(sorted({each.count(seen.arm.joints[j]) for each in heard}))
    words = {(1,): "in every message", (0,): none, (0, 1): "not in every message"}
    mend = "arm.joints needs the names of the joint states; one broadcaster for all joints of the arm"
    found = words.get(counts, "more than once in a message")
    return judged(counts == (1,), found, "once in every message", mend)


def fields(seen: Evidence) -> Finding | None:
    """The fields of each message fit together; no finding if they do."""
    text = f"{counted(seen.malformed, 'message')} with fields of different lengths"
    expected = "as many positions (velocities, efforts) as names"
    bad = judged(False, text, expected, "correct the publisher of the joint states")
    return bad if seen.malformed else None


def number_of_states(seen: Evidence) -> Finding | None:
    """There are enough states to judge; no finding if there are."""
    if len(seen.states) >= ENOUGH_STATES:
        return None
    text = f"{counted(len(seen.states), 'state')} with all joints in {seen.listened_s:g} s"
    mend = "mend the names, or look for a publisher that has stopped"
    return judged(False, text, f"at least {ENOUGH_STATES}", mend)


def rate_of_states(seen: Evidence) -> Finding:
    """States arrive at the configured rate, by our clock."""
    mend = (
        "set control.rate_hz to the rate of the joint states, or update_rate of the controller manager to "
        "control.rate_hz; a busy machine loses states as well"
    )
    return _rate(seen.states.received_s, seen.rate_hz, mend)


def rate_of_stamps(seen: Evidence) -> Finding:
    """The same by their stamps."""
    stamps = seen.states.stamp_ns
    distinct = stamps[np.flatnonzero(np.diff(stamps, prepend=stamps[:1] - 1))]
    mend = "every state needs the time of its own measurement as stamp"
    return _rate((distinct - distinct[:1]) / NS_PER_S, seen.rate_hz, mend)


def jitter(seen: Evidence) -> Finding:
    """States arrive evenly."""
    late_s = np.diff(seen.states.received_s) - 1.0 / seen.rate_hz
    p99_s, limit_s = float(np.percentile(np.abs(late_s), 99)), JITTER_PERIODS / seen.rate_hz
    longest_s = late_s.max() + 1 / seen.rate_hz
    found = f"99 % within {p99_s * 1e3:.2f} ms, longest gap {longest_s * 1e3:.1f} ms"
    mend = "look for other work on this machine and in the driver's loop; a real-time kernel helps"
    return judged(p99_s <= limit_s, found, f"99 % within {limit_s * 1e3:.1f} ms", mend, Verdict.WARNING)


def order_of_stamps(seen: Evidence) -> Finding:
    """Time goes forward from state to state."""
    steps = np.diff(seen.states.stamp_ns)
    back, same = int(np.sum(steps < 0)), int(np.sum(steps == 0))
    return judged(
        back == same == 0 and len(steps) > 0,
        f"{back} of {len(steps)} steps go back, {same} repeat a stamp",
        "each state newer than the one before",
        "look for a second or stale publisher of joint states, and for a driver that repeats old readings",
    )


def age(seen: Evidence) -> Finding:
    """States are fresh when they arrive."""
    age_s = float(np.median(seen.states.age_s))
    expected = f"{-CLOCK_TOLERANCE_S * 1e3:g} to {AGE_LIMIT_S * 1e3:g} ms"
    if seen.arm_has_own_clock:
        return unchecked("the stamps are the arm's own time", expected)
    mend = "look for a stale publisher, buffers and a slow network"
    if age_s < -CLOCK_TOLERANCE_S or age_s > 1.0:
        mend = "synchronise the clocks of both machines (chrony, PTP), or look for a stale publisher"
    if not seen.states.stamp_ns.any():
        mend = "the driver has to set the stamps, which are all 0, to the time of each measurement"
    measured = f"{age_s * 1e3:.1f} ms, at most {seen.states.age_s.max() * 1e3:.1f} ms"
    return judged(-CLOCK_TOLERANCE_S <= age_s <= AGE_LIMIT_S, measured, expected, mend)


def column(
    name: str, missing: str, good: str, expected: str, mend: str, otherwise: Verdict = Verdict.WARNING
) -> Callable[[Evidence], Finding]:
    """Return a check of whether a column of the states has numbers only."""

    def judge(seen: Evidence) -> Finding:
        finite = np.isfinite(getattr(seen.states, name)).all(axis=0)
        bad = ", ".join(np.array(seen.states.joints)[~finite])
        return judged(not bad, f"{missing}: {bad}" if bad else good, expected, mend, otherwise)

    return judge


positions = column(
    "position_rad",
    "not finite",
    "finite",
    "finite numbers of rad",
    "the driver has to send a number for each joint, or no message at all while it has none",
    Verdict.WRONG,
)
_SENT = ("missing", "sent", "sent for each joint")
velocities = column("velocity_rad_s", *_SENT, "they are then estimated from positions, which adds delay")
efforts = column("effort_nm", *_SENT, "a dead channel and the watchdog are then judged from the motion alone")


def posture(seen: Evidence, j: int) -> Finding:
    """A joint is inside its range."""
    low, high = np.min(seen.states.position_rad[:, j]), np.max(seen.states.position_rad[:, j])
    lowest, highest = seen.arm.position_min_rad[j], seen.arm.position_max_rad[j]
    return judged(
        bool(lowest <= low and high <= highest),
        f"{low:.4g} to {high:.4g} rad",
        f"{lowest:.4g} to {highest:.4g} rad",
        "are the positions degrees instead of radians? Else: the encoder's zero, arm.position_min_rad and "
        "position_max_rad, or move the joint back into its range by hand",
    )


def velocity(seen: Evidence, j: int) -> Finding:
    """The velocity, summed up over short windows, is how far the joint went in them.

    Windows in which the joint has not gone clearly further than the resolution of its position are left out.
    The ratio is the least-squares slope over all others: velocity = ratio × differentiated position.
    """
    states = seen.moving
    expected = f"{1 - VELOCITY_TOLERANCE:g} to {1 + VELOCITY_TOLERANCE:g} times the differentiated position"
    position, speed = states.position_rad[:, j], states.velocity_rad_s[:, j]
    if not np.isfinite(speed).all():
        return unchecked("no velocity is sent", expected)
    clear_rad = max(8.0 * float(states.resolution_rad()[j]), 1e-4)
    steps_rad = 0.5 * (speed[1:] + speed[:-1]) * np.diff(states.stamp_ns) / NS_PER_S
    sums = np.concatenate([[0.0], np.cumsum(steps_rad)])
    most_apart = 0
    for window_s in WINDOWS_S:
        first, last = _windows(states.stamp_ns, window_s)
        went, summed = position[last] - position[first], sums[last] - sums[first]
        clear = np.abs(went) > clear_rad
        most_apart = max(most_apart, _n_apart(first[clear], last[clear]))
        if most_apart >= ENOUGH_WINDOWS:
            ratio = float(went[clear] @ summed[clear] / (went[clear] @ went[clear]))
            measured = f"{ratio:.3g} times the differentiated position"
            return judged(abs(ratio - 1.0) <= VELOCITY_TOLERANCE, measured, expected, _mend_velocity(ratio))
    if most_apart or float(np.ptp(position)) > ENOUGH_WINDOWS * clear_rad:
        text = f"it has moved clearly {most_apart} times, at least {ENOUGH_WINDOWS} are needed"
        mend = "check again; are states missing (see rate, jitter)? Else move it by hand for longer"
        return unchecked(text, expected, mend)
    furthest = f"{np.abs(went).max(initial=0.0) * 1e3:.2g} mrad within {WINDOWS_S[-1] * 1e3:g} ms"
    text = f"the joint has hardly moved: {furthest}, {clear_rad * 1e3:.2g} mrad are needed"
    return unchecked(text, expected, "move it by hand while this listens, or let it be pulsed")


def _mend_velocity(ratio: float) -> str:
    if 0.5 * DEGREES < abs(ratio) < 2.0 * DEGREES:
        return "the velocity is in degrees/s: convert it to rad/s in the driver"
    if 0.5 / DEGREES < abs(ratio) < 2.0 / DEGREES:
        return "the position is in degrees and the velocity in rad/s: convert the position in the driver"
    if ratio < 0.0:
        return "the velocity's sign is flipped against the position's"
    return "position and velocity need the same unit (rad, rad/s), gear ratio and joint"


def listed(endpoints: Sequence[Endpoint]) -> str:
    """Return nodes and types of publishers or subscriptions."""
    return ", ".join(f"{node} ({kind})" for node, kind, _ in endpoints) or "none"


def _rate(times_s: FloatArray, rate_hz: float, mend: str) -> Finding:
    span_s = float(times_s[-1] - times_s[0]) if len(times_s) > 1 else 0.0
    found_hz = (len(times_s) - 1) / span_s if span_s > 0.0 else 0.0
    good = abs(found_hz / rate_hz - 1.0) <= RATE_TOLERANCE
    return judged(good, f"{found_hz:.1f} Hz", f"{rate_hz:g} Hz within {RATE_TOLERANCE:.0%}", mend)


def _windows(stamp_ns: IntArray, window_s: float) -> tuple[IntArray, IntArray]:
    """Return the first and the last state of windows, one from each state on; shape (n_windows,) each."""
    time_s = (stamp_ns - stamp_ns[0]) / NS_PER_S
    steps_s = np.diff(time_s)
    # No window spans a gap: the velocity in it is not known.
    gaps = np.flatnonzero((steps_s > WINDOWS_S[0]) | (steps_s <= 0.0)) + 1
    first, last = [], []
    for piece in np.split(np.arange(len(time_s)), gaps):
        # The tolerance keeps rounding of equal periods from adding one.
        ends = piece[0] + np.searchsorted(time_s[piece], time_s[piece] + window_s - 1e-6)
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
