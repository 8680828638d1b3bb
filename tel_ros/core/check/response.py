"""Checks of which joint moved when which was pushed, which way, and how far."""

from __future__ import annotations

import math
from collections.abc import Sequence

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


def pulses(seen: Evidence) -> Finding | None:
    """All pulses were sent; no finding if they were."""
    if seen.not_pulsed:
        return unchecked(seen.not_pulsed, "sign, scale, delay, watchdog")
    text, expected = f"ended early: {seen.pulsed.complaint}", "all pulses within the allowed range"
    return judged(False, text, expected, seen.pulsed.mend) if seen.pulsed.complaint else None


def effort_channel(seen: Evidence, j: int) -> Finding:
    """Something moves when a joint is pushed."""
    pulsed, expected = seen.pulsed, "the joint moves"
    own = pulsed.of(j)
    if not own:
        return unchecked(unsound(pulsed, j, seen.arm.joints), expected)
    pulse = max(own, key=lambda pulse: float((np.abs(pulse.reach_rad) / pulsed.visible_rad).max()))
    at = f"at ±{abs(pulse.effort_nm):.3g} N·m"
    if j in pulsed.moved:
        return judged(True, f"moves {at}", expected, "")
    furthest = int(np.argmax(np.abs(pulse.reach_rad) / pulsed.visible_rad))
    went_rad, needed_rad = abs(pulse.reach_rad[furthest]), pulsed.visible_rad[furthest]
    steps = f"steps of {pulsed.resolution_rad[furthest] * 1e3:.2g} mrad"
    needed = f"{needed_rad * 1e3:.2g} mrad are needed ({steps})"
    stronger = "push harder (--effort-share), with more room where the encoder is coarse (--range)"
    if went_rad >= pulsed.noticed_rad[furthest]:
        little = f"{seen.arm.joints[furthest]} moves by {went_rad * 1e3:.2g} mrad {at}"
        return unchecked(f"{little}; {needed}", expected, stronger)
    by_urdf_rad = expected_reach_rad(pulse, pulsed.model)
    if by_urdf_rad is not None and abs(by_urdf_rad) < needed_rad:
        little = f"it would move by {abs(by_urdf_rad) * 1e3:.2g} mrad {at} by the URDF"
        return unchecked(f"{little}; {needed}", expected, stronger)
    gain = abs(pulsed.effort_gain(j))
    mend = "is it on and the effort controller active? More friction than that: raise --effort-share"
    if all(each.stood_still for each in pulsed.pulses):
        mend = "nothing at all has changed in the joint states: is the drive on, or are the readings frozen?"
    elif gain > 0.5:
        other = "a brake, a stop, more friction than that (raise --effort-share)?"
        mend = f"the drive reports the effort: {other}"
    elif gain <= 0.5:
        mend = f"the drive reports no such effort: {mend}"
    return judged(False, f"nothing moves {at}", expected, mend)


def wiring(seen: Evidence, j: int) -> Finding:
    """Each effort reaches its own joint."""
    joint, target = seen.arm.joints[j], int(reached_joints(seen.pulsed)[j])
    own = "its command moves this joint"
    if target < 0:
        return unchecked(unsound(seen.pulsed, j, seen.arm.joints), own)
    reached = seen.arm.joints[target]
    mend = (
        f"{joint} and {reached} are swapped: compare the joints of the effort controller and the names in "
        "the joint states with arm.joints, and the cables of the drives"
    )
    return judged(target == j, own if target == j else f"its command moves {reached}", own, mend)


def sign(seen: Evidence, j: int) -> Finding:
    """Each joint moves with its effort, not against it."""
    target, expected = int(reached_joints(seen.pulsed)[j]), "moves with the effort"
    if target < 0 or _drifts(seen.pulsed, j, target):
        return unchecked(unsound(seen.pulsed, j, seen.arm.joints), expected)
    good = bool(response_matrix(seen.pulsed)[target, j] > 0.0)
    mend = (
        "flip the sign of the effort, or of position and velocity, in the driver (if not all joints were "
        "pulsed, it may also be swapped with another)"
    )
    return judged(good, expected if good else "moves against the effort", expected, mend)


def both_ways(seen: Evidence, j: int) -> Finding | None:
    """Each joint moves both ways; no finding for those that do.

    Cogging and dry friction make one way shorter than the other, so one of them has to be hardly visible.
    """
    pulsed = seen.pulsed
    ways_rad = sorted((p.reach_rad[j] * np.sign(p.effort_nm) for p in pulsed.of(j)), key=abs)
    limit_rad = min(pulsed.visible_rad[j], ONE_WAY_SHARE * abs(ways_rad[-1])) if ways_rad else 0.0
    one_way = reached_joints(pulsed)[j] == j and abs(ways_rad[0]) < limit_rad
    if not one_way and not _drifts(pulsed, j, j):
        return None
    less, more = (f"{1e3 * way_rad + 0.0:.2g} mrad" for way_rad in ways_rad)
    mend = "it leans on a support or stop, or gravity is stronger: lay the arm where it is free"
    found = f"moves {more} with the push one way and {less} the other"
    return judged(False, found, "moves both ways", mend, Verdict.WARNING)


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
    ways_rad, visible_rad = [pulse.reach_rad[target] for pulse in pulsed.of(j)], pulsed.visible_rad[target]
    return bool(ways_rad) and bool(min(ways_rad) >= visible_rad or max(ways_rad) <= -visible_rad)


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


def effort_scale(seen: Evidence, j: int) -> Finding:
    """A joint that is wired rightly goes about as far as rigid links with the inertia of the URDF would."""
    pulsed, expected = seen.pulsed, f"{1 / SCALE_TOLERANCE:.2g} to {SCALE_TOLERANCE:g}"
    if pulsed.model.inertia_kgm2 is None:
        return unchecked(pulsed.model.missing, expected)
    if reached_joints(pulsed)[j] != j:
        return unchecked(unsound(pulsed, j, seen.arm.joints), expected)
    pairs = [(p.reach_rad[j], expected_reach_rad(p, pulsed.model)) for p in pulsed.of(j)]
    ratio = float(np.median([abs(went_rad / goes_rad) for went_rad, goes_rad in pairs if goes_rad]))
    mend = "friction that is not in the URDF, a brake, or efforts that are not N·m at the joint"
    if 0.5 * DEGREES < ratio < 2.0 * DEGREES:
        mend = "the positions are probably degrees instead of radians: convert them in the driver"
    elif ratio > SCALE_TOLERANCE:
        mend = "efforts have to be N·m at the joint (gear ratio, current, percent?), positions rad"
    good, otherwise = 1.0 / SCALE_TOLERANCE <= ratio <= SCALE_TOLERANCE, Verdict.WARNING
    if ratio > SCALE_TOLERANCE:
        otherwise = Verdict.WRONG
    return judged(good, f"moves {ratio:.3g} times as far as by the URDF", expected, mend, otherwise)


def expected_reach_rad(pulse: Pulse, model: UrdfModel) -> float | None:
    """Return how far a joint goes if M q̈ + D q̇ = τ, without gravity and dry friction; None without M."""
    inertia = model.inertia_kgm2
    if inertia is None:
        return None
    times_s = np.array([pulse.turn_s, pulse.zero_s, pulse.end_s])
    turn_s, zero_s, duration_s = pulse.arm_time_factor() * (times_s - pulse.start_s)
    n_steps = max(1, math.ceil(duration_s / _STEP_S))
    dt = duration_s / n_steps
    now_s = (np.arange(n_steps) + 0.5) * dt
    effort_nm = pulse.effort_nm * np.select([now_s < turn_s, now_s < zero_s], [1.0, -1.0], 0.0)
    # Implicit Euler is stable for light joints with strong friction.
    solve = np.linalg.inv(inertia + dt * np.diag(model.friction_nms_per_rad))
    speeds = [np.zeros(len(inertia))]
    for effort in effort_nm:
        speeds.append(solve @ (inertia @ speeds[-1]) + dt * effort * solve[:, pulse.joint])
    speed = np.array(speeds)[:, pulse.joint]
    position = np.cumsum(0.5 * dt * (speed[1:] + speed[:-1]))
    return float(position[np.argmax(np.abs(position))])
