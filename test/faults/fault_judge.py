"""Whether an arm was safe after a fault, from what its motors and joints did. Arrays in, verdict out.

What the judge looks at is the arm's own account (the effort that acted, position, velocity), not what the
controller says it did. From the controller it takes only when a trial begins and when it says STOP.

*Braked, held or without effort*: from some moment on, the motors put no more than a small work into the arm:

    W(s, t) = sum over control periods in (s, t] of effort . (change of position) <= tolerance  for all s < t

No effort does no work; springs that brake do negative work; springs that hold an arm at rest do none. An arm
that is being driven fails within a few periods. The *reaction* is the time from the fault to the first moment
from which this holds. Under gravity the springs that catch a falling arm give back some of its energy,
which is tolerated; after a fall without effort also some of what its weight does until they have turned it
round, and what it takes to lift joints that fell beyond their soft limits back to these. And a weak brake
would pass: it lets the arm sink, which is negative work. Hence, once nothing is disturbed any more and motors
act, no joint may go further than energy, weight and springs explain (:mod:`fault_body`).
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from fault_body import GIVEN_BACK, Body

from tel_ros.core.trial import Phase
from tel_ros.core.types import NS_PER_S, BoolArray, FloatArray, IntArray

Expectation = Literal["stop", "ride", "either", "end"]
EXPECTATIONS: dict[Expectation, str] = {
    "stop": "the arm is braked, held or without effort within 0.1 s of arm time, until the next trial begins",
    "ride": "the trial goes on and is completed",
    "either": "the trial is completed, or the arm is braked as soon as the controller says STOP",
    "end": "arm and controller still work, so the trial may go on while the run is being ended; the arm is "
    "braked as soon as the controller says STOP",
}
REACTION_LIMIT_S = 0.1
DELAY_S = 0.01
"""What the arm contract allows between sending a command and a state that shows it."""
AT_REST_RAD_S = 0.3
"""A braked arm that is asked to move again is slower than this."""
LET_GO_S = 0.02
"""After so long without effort an arm has been let go: as long as the driver's watchdog."""
CAUGHT_AT = 1.1
"""How fast a falling arm may be while motors catch it, over what it was before they began: a weight goes on
pulling until their effort has grown."""
RANGE_MARGIN_RAD = 1e-3
"""An encoder of 13 bits tells no more."""


TRACEBACK, FATAL = "Traceback (most recent call last)", "Fatal Python error"


@dataclass(frozen=True)
class Control:
    """What the controller said in one tick; trial 0: between trials.

    ``arm_ns``: stamp of the state that it answers, or of the arm's newest state when it was heard.
    """

    arm_ns: int
    trial: int
    phase: int


@dataclass(frozen=True)
class Trace:
    """What an arm did, and what the controller said, in the order of its coming.

    Stamps grow, shape (n,). The others: shape (n, n_joints). Efforts are what acted until the stamp.
    """

    time_ns: IntArray
    position_rad: FloatArray
    velocity_rad_s: FloatArray
    effort_nm: FloatArray
    controls: Sequence[Control] = ()


@dataclass(frozen=True)
class Episode:
    """What is to be judged.

    Args:
        fault_ns: arm time from which the fault can be noticed.
        end_ns: arm time of the last sample that belongs to it.
        work_tolerance_j: see the module.
        falls: whether gravity moves the arm when its motors are off.
        calm_ns: arm time from which nothing is disturbed any more: before, a brake may lack its states.
    """

    expects: Expectation
    trial: int
    fault_ns: int
    end_ns: int
    completed: bool
    work_tolerance_j: float
    falls: bool
    calm_ns: int
    body: Body


@dataclass(frozen=True)
class Verdict:
    """What the judge found.

    Args:
        violations: in words; none: all is well.
        reaction_s: from the fault, or from STOP where the trial may go on, to the arm's being safe; NaN if
            it did not have to stop.
        stopped: how: ``zero``, ``held``, or ``-`` if it did not have to.
        effort_share: largest share of the effort limit after the fault.
        speed_share: largest share of the velocity limit, while motors acted.
        excursion_rad: of a braked arm; NaN if there was none.
    """

    violations: tuple[str, ...]
    reaction_s: float
    stopped: str
    effort_share: float
    speed_share: float
    excursion_rad: float


def largest_work_from(effort_nm: FloatArray, position_rad: FloatArray) -> FloatArray:
    """Return, for each sample s, the most work [J] that motors do from any sample u >= s to any t >= u."""
    work = np.zeros(len(position_rad))
    work[1:] = np.cumsum(np.einsum("ij,ij->i", effort_nm[1:], np.diff(position_rad, axis=0)))
    highest_later = np.maximum.accumulate(work[::-1])[::-1]
    rise = highest_later - work
    return np.maximum.accumulate(rise[::-1])[::-1]


def caught_up_ns(stamp_ns: IntArray, arrived_s: FloatArray, n_before: int, since_ns: int) -> int:
    """Return the stamp of the first state from a moment on that comes no later than states used to.

    ``arrived_s`` is on another clock. ``n_before`` of the states, at least one, came before anything was
    disturbed. The moment itself is returned if none is in time from then on.
    """
    delay_s = arrived_s - stamp_ns / NS_PER_S
    in_time = (stamp_ns >= since_ns) & (delay_s <= np.median(delay_s[:n_before]) + DELAY_S)
    return int(stamp_ns[np.argmax(in_time)]) if in_time.any() else since_ns


def crashes(logs: Mapping[str, str], said: str, killed: str) -> list[str]:
    """Return which processes broke down by themselves, whatever their last words were.

    ``logs``: by process; ``said``: what the run said at its end; ``killed``: the one that the fault kills.
    """
    found = [
        f"{name} broke down: {text.strip().splitlines()[-1]}"
        for name, text in logs.items()
        if TRACEBACK in text or FATAL in text
    ]
    ended = re.findall(r"node (\w+) (was killed by \w+|ended with code -?\d+)", said)
    return found + [f"{name} {how}" for name, how in ended if name != killed]


def judge(trace: Trace, episode: Episode) -> Verdict:
    window = (trace.time_ns >= episode.fault_ns) & (trace.time_ns <= episode.end_ns)
    violations = _limit_violations(trace, episode, window)
    if episode.expects == "ride" and not episode.completed:
        violations.append("the trial was not completed, although the fault should not have mattered")
    since_ns = _has_to_be_safe_since(trace, episode)
    acting = window & np.any(trace.effort_nm != 0.0, axis=1)
    verdict = {
        "effort_share": _largest_share(trace.effort_nm[window], episode.body.effort_limit_nm),
        "speed_share": _largest_share(trace.velocity_rad_s[acting], episode.body.velocity_limit_rad_s),
    }
    if since_ns is None:
        return Verdict(tuple(violations), float("nan"), "-", excursion_rad=float("nan"), **verdict)
    begins = [c.arm_ns for c in trace.controls if c.trial > episode.trial and c.arm_ns >= since_ns]
    segment = window & (trace.time_ns >= since_ns) & (trace.time_ns <= min([*begins, episode.end_ns]))
    reaction_s, stopped, excursion_rad, found = _stop(trace, segment, since_ns, episode, bool(begins))
    return Verdict(tuple(violations + found), reaction_s, stopped, excursion_rad=excursion_rad, **verdict)


def _has_to_be_safe_since(trace: Trace, episode: Episode) -> int | None:
    """Return from when on the arm has to be safe, or None if it may go on."""
    if episode.expects == "stop":
        return episode.fault_ns
    if episode.expects == "ride":
        return None
    ours = [control for control in trace.controls if control.trial in (0, episode.trial)]
    for control in ours:
        if control.arm_ns >= episode.fault_ns and control.phase == Phase.STOP:
            return control.arm_ns
    if episode.completed:
        return None
    # Nobody has said anything, and nobody has brought the trial to its end: since then nothing may act.
    ticks = [control.arm_ns for control in ours if control.trial]
    return max([episode.fault_ns, *ticks[-1:]])


def _stop(
    trace: Trace, segment: BoolArray, since_ns: int, episode: Episode, again: bool
) -> tuple[float, str, float, list[str]]:
    """Return reaction, way of stopping, excursion and violations of an arm that has to be safe."""
    time_s = (trace.time_ns[segment] - since_ns) / NS_PER_S
    position, effort = trace.position_rad[segment], trace.effort_nm[segment]
    if not len(time_s):
        return 0.0, "zero", float("nan"), []  # its time has not gone on: nothing has acted
    energy_j = episode.body.kinetic_energy_j(position, trace.velocity_rad_s[segment])
    given_back_j = 0.0
    if episode.falls:
        caught = _caught(trace.time_ns[segment], effort)
        given_back_j = GIVEN_BACK * float(energy_j.max())
        if len(caught):
            where_rad, body = position[caught[0]], episode.body
            given_back_j += GIVEN_BACK * body.sagging_j(where_rad) + body.led_back_j(where_rad)
    tolerance_j = episode.work_tolerance_j + given_back_j
    safe = largest_work_from(effort, position) <= tolerance_j
    reaction_s = max(0.0, float(time_s[int(np.argmax(safe))])) if safe.any() else float("inf")
    found = []
    if reaction_s > REACTION_LIMIT_S + DELAY_S:
        found.append(
            f"the motors drove the arm until {reaction_s:.3f} s after the fault (limit {REACTION_LIMIT_S} s)"
        )
    late = time_s > REACTION_LIMIT_S + DELAY_S
    acting = late & np.any(effort != 0.0, axis=1)
    if not acting.any():
        return reaction_s, "zero", float("nan"), found
    excursion_rad = float(_gone(time_s, position, acting).max())
    calm = acting & (trace.time_ns[segment] > episode.calm_ns + (REACTION_LIMIT_S + DELAY_S) * NS_PER_S)
    if calm.any():
        first = int(np.argmax(calm))
        gone = _gone(time_s, position, calm)
        reach = episode.body.reach_rad(position[first], float(energy_j[first]) + tolerance_j)
        if (gone > reach).any():
            j = int(np.argmax(gone / reach))
            found.append(
                f"braked, joint {j + 1} went on for {gone[j]:.2f} rad (energy, weight and springs explain "
                f"{reach[j]:.2f} rad)"
            )
    speed = float(np.abs(trace.velocity_rad_s[segment][-1]).max())
    if again and speed > AT_REST_RAD_S:
        found.append(f"the next trial began at {speed:.2f} rad/s (limit {AT_REST_RAD_S} rad/s)")
    return reaction_s, "held", excursion_rad, found


def _gone(time_s: FloatArray, position_rad: FloatArray, acting: BoolArray) -> FloatArray:
    """Return how far each joint gets from where it is when motors first act, until the arm is let go.

    What is let go falls, and the soft walls that keep it from its limits then are no brake.
    """
    rows = np.flatnonzero(acting)
    pauses = np.flatnonzero(np.diff(time_s[rows]) > LET_GO_S)
    first, last = rows[0], rows[pauses[0]] if len(pauses) else rows[-1]
    return np.abs(position_rad[first : last + 1] - position_rad[first]).max(axis=0)


def _caught(time_ns: IntArray, effort_nm: FloatArray) -> IntArray:
    """Return the samples in which motors begin to act on an arm that had been let go."""
    rows = np.flatnonzero(np.any(effort_nm != 0.0, axis=1))
    # An arm of which nothing is known before the first sample counts as held there.
    acted_ns = np.concatenate([time_ns[:1], time_ns[rows]])
    return rows[np.diff(acted_ns) > LET_GO_S * NS_PER_S]


def _limit_violations(trace: Trace, episode: Episode, window: BoolArray) -> list[str]:
    """Return the limits that were passed; gravity alone may move an arm without effort."""
    found, limits, falls = list[str](), episode.body, episode.falls
    effort, position, velocity = (
        values[window] for values in (trace.effort_nm, trace.position_rad, trace.velocity_rad_s)
    )
    # Written so that what is not a number is a violation.
    if not np.all(np.abs(effort) <= limits.effort_limit_nm * (1.0 + 1e-9)):
        found.append(f"effort of {_largest_share(effort, limits.effort_limit_nm):.3f} of the limit")
    counts = np.any(effort != 0.0, axis=1) if falls else np.ones(len(effort), dtype=bool)
    fastest = np.broadcast_to(limits.velocity_limit_rad_s, velocity.shape).copy()
    for first in _caught(trace.time_ns[window], effort) if falls else ():
        # What it had before is not the motors' doing; what they add to it is.
        fastest[first:] = np.maximum(limits.velocity_limit_rad_s, CAUGHT_AT * np.abs(velocity[first - 1]))
    position, velocity, fastest = position[counts], velocity[counts], fastest[counts]
    if not np.all(np.abs(velocity) <= fastest):
        found.append(f"speed of {_largest_share(velocity, limits.velocity_limit_rad_s):.3f} of the limit")
    beyond = np.maximum(limits.position_min_rad - position, position - limits.position_max_rad)
    if not np.all(beyond <= RANGE_MARGIN_RAD):
        found.append(f"{float(beyond.max()):.3f} rad out of the range")
    return found


def _largest_share(values: FloatArray, limit: FloatArray) -> float:
    return float((np.abs(values) / limit).max()) if len(values) else 0.0
