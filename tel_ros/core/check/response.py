"""Checks of which joint moved when which was pushed, which way, and how far."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from tel_ros.core.check.evidence import (
    DEGREES,
    Evidence,
    Finding,
    Pulse,
    Pulsed,
    UrdfModel,
    Verdict,
    judged,
    unchecked,
)
from tel_ros.core.types import FloatArray, IntArray

SCALE_TOLERANCE = 3.0
"""Factor by which an arm may move more or less than its URDF says."""
ONE_WAY_SHARE = 0.3
"""A joint that goes up to this share as far one way as the other may be held there."""
_STEP_S = 1e-3


def pulses(seen: Evidence) -> Iterator[Finding]:
    """All pulses were sent; no finding if they were."""
    if seen.not_pulsed:
        yield unchecked(seen.not_pulsed, "sign, scale, delay, watchdog")
    elif seen.pulses is not None and seen.pulses.complaint:
        text = f"ended early: {seen.pulses.complaint}"
        yield judged(False, text, "all pulses within the allowed range", seen.pulses.mend)


def effort_channel(seen: Evidence) -> Iterator[Finding]:
    """Something moves when a joint is pushed."""
    pulsed, expected = seen.pulsed, "the joint moves"
    stronger = "push harder (--effort-share), with more room where the encoder is coarse (--range)"
    for j, joint in enumerate(seen.arm.joints):
        own = pulsed.of(j)
        if not own:
            yield unchecked(unsound(pulsed, j, seen.arm.joints), expected, joint=joint)
            continue
        pulse = max(own, key=lambda pulse: float((np.abs(pulse.reach_rad) / pulsed.visible_rad).max()))
        furthest = int(np.argmax(np.abs(pulse.reach_rad) / pulsed.visible_rad))
        went_rad, needed_rad = abs(pulse.reach_rad[furthest]), pulsed.visible_rad[furthest]
        by_urdf_rad = expected_reach_rad(pulse, pulsed.model)
        at = f"at ±{abs(pulse.effort_nm):.3g} N·m"
        step_rad = pulsed.resolution_rad[furthest]
        needed = f"; {needed_rad * 1e3:.2g} mrad are needed (steps of {step_rad * 1e3:.2g} mrad)"
        if j in pulsed.moved:
            yield judged(True, f"moves {at}", expected, "", joint=joint)
        elif went_rad >= pulsed.noticed_rad[furthest]:
            little = f"{seen.arm.joints[furthest]} moves by {went_rad * 1e3:.2g} mrad {at}{needed}"
            yield unchecked(little, expected, stronger, joint)
        elif by_urdf_rad is not None and abs(by_urdf_rad) < needed_rad:
            little = f"it would move by {abs(by_urdf_rad) * 1e3:.2g} mrad {at} by the URDF{needed}"
            yield unchecked(little, expected, stronger, joint)
        else:
            yield judged(False, f"nothing moves {at}", expected, _mend_channel(pulsed, j), joint=joint)


def _mend_channel(pulsed: Pulsed, joint: int) -> str:
    if all(pulse.stood_still for pulse in pulsed.pulses):
        return "nothing at all has changed in the joint states: is the drive on, or are the readings frozen?"
    gain = abs(pulsed.effort_gain(joint))
    if gain > 0.5:
        return (
            "the drive reports the effort: a brake, a stop, more friction than that (raise --effort-share)?"
        )
    reports = "the drive reports no such effort: " if gain <= 0.5 else ""
    return (
        f"{reports}is it on and the effort controller active? More friction than that: raise --effort-share"
    )


def wiring(seen: Evidence) -> Iterator[Finding]:
    """Each effort reaches its own joint."""
    joints, target, own = seen.arm.joints, reached_joints(seen.pulsed), "its command moves this joint"
    for j, joint in enumerate(joints):
        if target[j] < 0:
            yield unchecked(unsound(seen.pulsed, j, joints), own, joint=joint)
            continue
        reached = joints[target[j]]
        mend = (
            f"{joint} and {reached} are swapped: compare the joints of the effort controller and the names "
            "in the joint states with arm.joints, and the cables of the drives"
        )
        found = own if joint == reached else f"its command moves {reached}"
        yield judged(joint == reached, found, own, mend, joint=joint)


def sign(seen: Evidence) -> Iterator[Finding]:
    """Each joint moves with its effort, not against it."""
    pulsed, expected = seen.pulsed, "moves with the effort"
    response, target = response_matrix(pulsed), reached_joints(pulsed)
    mend = (
        "flip the sign of the effort, or of position and velocity, in the driver (if not all joints were "
        "pulsed, it may also be swapped with another)"
    )
    for j, joint in enumerate(seen.arm.joints):
        if target[j] < 0 or _drifts(pulsed, j, int(target[j])):
            yield unchecked(unsound(pulsed, j, seen.arm.joints), expected, joint=joint)
            continue
        good = bool(response[target[j], j] > 0.0)
        yield judged(good, expected if good else "moves against the effort", expected, mend, joint=joint)


def both_ways(seen: Evidence) -> Iterator[Finding]:
    """Each joint moves both ways; no finding for those that do.

    Cogging and dry friction make one way shorter than the other, so one of them has to be hardly visible.
    """
    pulsed, target = seen.pulsed, reached_joints(seen.pulsed)
    for j, joint in enumerate(seen.arm.joints):
        ways_rad = sorted((p.reach_rad[j] * np.sign(p.effort_nm) for p in pulsed.of(j)), key=abs)
        limit_rad = min(pulsed.visible_rad[j], ONE_WAY_SHARE * abs(ways_rad[-1])) if ways_rad else 0.0
        one_way = target[j] == j and abs(ways_rad[0]) < limit_rad
        if one_way or _drifts(pulsed, j, j):
            mend = "it leans on a support or stop, or gravity is stronger: lay the arm where it is free"
            less, more = (f"{1e3 * way_rad + 0.0:.2g} mrad" for way_rad in ways_rad)
            ways = f"moves {more} with the push one way and {less} the other"
            yield judged(False, ways, "moves both ways", mend, joint=joint, otherwise=Verdict.WARNING)


def unsound(pulsed: Pulsed, j: int, joints: Sequence[str]) -> str:
    """Return why a joint cannot show what its drive does with a command; empty if it answers its own."""
    if not pulsed.of(j):
        return "the pulses ended before its turn"
    if j not in pulsed.moved:
        return "it has not moved clearly when it was pushed"
    target = int(reached_joints(pulsed)[j])
    if target < 0:
        return "its push moves another joint more, whose own command moves nothing"
    if _drifts(pulsed, j, target):
        return f"{joints[target]} moves the same way, whichever way it is pushed"
    if target != j:
        return f"its command moves {joints[target]}"
    return "" if response_matrix(pulsed)[j, j] > 0.0 else "it moves against its effort"


def _drifts(pulsed: Pulsed, j: int, target: int) -> bool:
    """Return whether a joint moves the same way whichever way another, or itself, is pushed."""
    ways_rad = [float(pulse.reach_rad[target]) for pulse in pulsed.of(j)]
    return bool(ways_rad) and (
        min(ways_rad) >= pulsed.visible_rad[target] or max(ways_rad) <= -pulsed.visible_rad[target]
    )


def response_matrix(pulsed: Pulsed) -> FloatArray:
    """Return how far joint i goes when joint j is pushed, per N·m: row i, column j."""
    n = len(pulsed.visible_rad)
    result = np.zeros((n, n))
    for j in {pulse.joint for pulse in pulsed.pulses}:
        result[:, j] = np.mean([pulse.reach_rad / pulse.effort_nm for pulse in pulsed.of(j)], axis=0)
    return result


def reached_joints(pulsed: Pulsed) -> IntArray:
    """Return which joint the effort of each joint reaches: -1 if it moves nothing, or it is not clear which.

    It is not clear where a joint moves more whose own command moves nothing: it may be carried along by
    its neighbour, or driven by the command of that.
    """
    n = len(pulsed.visible_rad)
    result, moved = np.full(n, -1), pulsed.moved
    response = np.abs(response_matrix(pulsed))
    result[moved] = np.array(moved, dtype=int)[assignment(response[np.ix_(moved, moved)])]
    for j in moved:
        silent = [i for i in range(n) if i not in moved]
        if silent and response[silent, j].max() > response[result[j], j]:
            own = np.any([abs(p.reach_rad[result[j]]) >= pulsed.visible_rad[result[j]] for p in pulsed.of(j)])
            result[j] = -1 if own else silent[int(np.argmax(response[silent, j]))]
    return result


def assignment(response: FloatArray) -> IntArray:
    """Return which joint the effort of each joint reaches: its own number if the wiring is right.

    The response of a rightly wired arm is that of its inverse inertia, which is symmetric and positive
    definite. The product of the diagonal of such a matrix exceeds that over any other permutation, since
    |A_ij| < √(A_ii A_jj); scaling rows and columns (units, efforts) does not change that. So the permutation
    with the largest product is the wiring, without a model. That a joint moves most when it is pushed itself
    would be a wrong rule: a light forearm moves more than the shoulder that is pushed.
    """
    from scipy.optimize import linear_sum_assignment  # late: it takes as long to load as all the rest

    size = np.log(np.maximum(np.abs(response), 1e-12))
    return np.asarray(linear_sum_assignment(size.T, maximize=True)[1])


def effort_scale(seen: Evidence) -> Iterator[Finding]:
    """Joints that are wired rightly go about as far as rigid links with the inertia of the URDF would."""
    pulsed, expected = seen.pulsed, f"{1 / SCALE_TOLERANCE:.2g} to {SCALE_TOLERANCE:g}"
    if pulsed.model.inertia_kgm2 is None:
        yield unchecked(pulsed.model.missing, "as far as by the inertia in the URDF")
        return
    target = reached_joints(pulsed)
    for j, joint in enumerate(seen.arm.joints):
        pairs = [(p.reach_rad[j], expected_reach_rad(p, pulsed.model)) for p in pulsed.of(j)]
        if target[j] != j:
            yield unchecked(unsound(pulsed, j, seen.arm.joints), expected, joint=joint)
            continue
        ratio = float(np.median([abs(went_rad / goes_rad) for went_rad, goes_rad in pairs if goes_rad]))
        high = ratio > SCALE_TOLERANCE
        mend = "friction that is not in the URDF, a brake, or efforts that are not N·m at the joint"
        if high:
            mend = "efforts have to be N·m at the joint (gear ratio, current, percent?), positions rad"
            if 0.5 * DEGREES < ratio < 2.0 * DEGREES:
                mend = "the positions are probably degrees instead of radians: convert them in the driver"
        yield judged(
            1.0 / SCALE_TOLERANCE <= ratio <= SCALE_TOLERANCE,
            f"moves {ratio:.3g} times as far as by the URDF",
            expected,
            mend,
            joint=joint,
            otherwise=Verdict.WRONG if high else Verdict.WARNING,
        )


def expected_reach_rad(pulse: Pulse, model: UrdfModel) -> float | None:
    """Return how far a joint goes if M q̈ + D q̇ = τ, without gravity and dry friction; None without M."""
    inertia = model.inertia_kgm2
    if inertia is None:
        return None
    times_s = np.array([pulse.turn_s, pulse.zero_s, pulse.end_s])
    turn_s, zero_s, duration_s = (pulse.arm_time_factor() * (times_s - pulse.start_s)).tolist()
    n_steps = max(1, math.ceil(duration_s / _STEP_S))
    dt = duration_s / n_steps
    # Implicit Euler is stable for light joints with strong friction.
    solve = np.linalg.inv(inertia + dt * np.diag(model.friction_nms_per_rad))
    velocity, effort, position, furthest = np.zeros(len(inertia)), np.zeros(len(inertia)), 0.0, 0.0
    for k in range(n_steps):
        now_s = (k + 0.5) * dt
        effort[pulse.joint] = pulse.effort_nm * (1.0 if now_s < turn_s else -1.0 if now_s < zero_s else 0.0)
        before = velocity[pulse.joint]
        velocity = solve @ (inertia @ velocity + dt * effort)
        position += float(0.5 * dt * (before + velocity[pulse.joint]))
        furthest = max(furthest, position, key=abs)
    return furthest
