"""Checks of which joint moved when which was pushed, which way, and how far."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np
from scipy.optimize import linear_sum_assignment

from tel_ros.core.check.evidence import DEGREES, Evidence, Finding, Pulse, Pulsed, Verdict, judged, unchecked
from tel_ros.core.types import FloatArray, IntArray

SCALE_TOLERANCE = 3.0
"""Factor by which an arm may move more or less than its URDF says."""
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
    for j, joint in enumerate(seen.arm.joints):
        own = pulsed.of(j)
        if not own:
            yield unchecked("no pulse was sent to it", expected, joint=joint)
            continue
        effort_nm = max(abs(pulse.effort_nm) for pulse in own)
        good = j in pulsed.moved
        measured = f"{'moves' if good else 'nothing moves'} at ±{effort_nm:.3g} N·m"
        mend = (
            "is the drive on and the effort controller active? More friction than that: raise --effort-share"
        )
        yield judged(good, measured, expected, mend, joint=joint)


def wiring(seen: Evidence) -> Iterator[Finding]:
    """Each effort reaches its own joint."""
    joints, target, own = seen.arm.joints, _target(seen.pulsed), "its command moves this joint"
    for j in seen.pulsed.moved:
        joint, reached = joints[j], joints[target[j]]
        mend = (
            f"{joint} and {reached} are swapped: compare the joints of the effort controller and the names "
            "in the joint states with arm.joints, and the cables of the drives"
        )
        found = own if joint == reached else f"its command moves {reached}"
        yield judged(joint == reached, found, own, mend, joint=joint)


def sign(seen: Evidence) -> Iterator[Finding]:
    """Each joint moves with its effort, not against it."""
    pulsed, expected = seen.pulsed, "moves with the effort"
    response, target = response_matrix(pulsed.pulses, len(seen.arm.joints)), _target(pulsed)
    mend = (
        "flip the sign of the effort, or of position and velocity, in the driver (if not all joints were "
        "pulsed, it may also be swapped with another)"
    )
    for j in pulsed.moved:
        good = bool(response[target[j], j] > 0.0)
        measured = expected if good else "moves against the effort"
        yield judged(good, measured, expected, mend, joint=seen.arm.joints[j])


def both_ways(seen: Evidence) -> Iterator[Finding]:
    """Each joint moves both ways; no finding for those that do."""
    pulsed, target = seen.pulsed, _target(seen.pulsed)
    for j in pulsed.moved:
        ways = [abs(float(p.displacement_rad()[j])) for p in pulsed.of(j)]
        if target[j] == j and len(ways) >= 2 and min(ways) <= 0.2 * max(ways):
            mend = "it leans on a support or stop, or gravity is stronger: lay the arm where it is free"
            text, expected, joint = "moves one way only", "moves both ways", seen.arm.joints[j]
            yield judged(False, text, expected, mend, joint=joint, otherwise=Verdict.WARNING)


def response_matrix(pulses: Sequence[Pulse], n_joints: int) -> FloatArray:
    """Return how far joint i goes when joint j is pushed, per N·m: row i, column j."""
    result = np.zeros((n_joints, n_joints))
    for joint in {pulse.joint for pulse in pulses}:
        went = [p.displacement_rad() / p.effort_nm for p in pulses if p.joint == joint]
        result[:, joint] = np.mean(went, axis=0)
    return result


def reached_joints(response: FloatArray, moved: Sequence[int]) -> IntArray:
    """Return which joint the effort of each pushed joint reaches: its own number if the wiring is right.

    The response of a rightly wired arm is that of its inverse inertia, which is symmetric and positive
    definite. The product of the diagonal of such a matrix exceeds that over any other permutation, since
    |A_ij| < √(A_ii A_jj); scaling rows and columns (units, efforts) does not change that. So the permutation
    with the largest product is the wiring, without a model. That a joint moves most when it is pushed itself
    would be a wrong rule: a light forearm moves more than the shoulder that is pushed. ``moved`` are the
    columns in which something moved.
    """
    result, known = np.arange(len(response)), np.array(moved, dtype=int)
    size = np.log(np.maximum(np.abs(response[np.ix_(known, known)]), 1e-12))
    rows, columns = linear_sum_assignment(size.T, maximize=True)
    result[known[rows]] = known[columns]
    return result


def _target(pulsed: Pulsed) -> IntArray:
    return reached_joints(response_matrix(pulsed.pulses, len(pulsed.visible_rad)), pulsed.moved)


def effort_scale(seen: Evidence) -> Iterator[Finding]:
    """Joints that are wired rightly go about as far as rigid links with the inertia of the URDF would."""
    pulsed, expected = seen.pulsed, f"{1 / SCALE_TOLERANCE:.2g} to {SCALE_TOLERANCE:g}"
    if pulsed.inertia_kgm2 is None:
        yield unchecked("the URDF's inertia is not known (pip install pin)", "as the URDF says")
        return
    target = _target(pulsed)
    for j in pulsed.moved:
        if target[j] != j:
            continue
        of_urdf = (pulsed.inertia_kgm2, pulsed.friction_nms_per_rad)
        pairs = [(p.displacement_rad()[j], expected_displacement(p, *of_urdf)) for p in pulsed.of(j)]
        ratios = [went_rad / goes_rad for went_rad, goes_rad in pairs if goes_rad != 0.0]
        if not ratios:
            continue
        ratio = float(np.median(np.abs(ratios)))
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
            joint=seen.arm.joints[j],
            otherwise=Verdict.WRONG if high else Verdict.WARNING,
        )


def expected_displacement(pulse: Pulse, inertia_kgm2: FloatArray, damping_nms_per_rad: FloatArray) -> float:
    """Return how far the pushed joint goes in rad if M q̈ + D q̇ = τ, without gravity and dry friction."""
    times_s = np.array([pulse.turn_s, pulse.zero_s, pulse.end_s])
    turn_s, zero_s, duration_s = (pulse.arm_time_factor() * (times_s - pulse.start_s)).tolist()
    n_steps = max(1, math.ceil(duration_s / _STEP_S))
    dt = duration_s / n_steps
    # Implicit Euler is stable for light joints with strong friction.
    solve = np.linalg.inv(inertia_kgm2 + dt * np.diag(damping_nms_per_rad))
    velocity, position = np.zeros(len(inertia_kgm2)), np.zeros(len(inertia_kgm2))
    for k in range(n_steps):
        now_s = (k + 0.5) * dt
        effort = np.zeros(len(inertia_kgm2))
        if now_s < zero_s:
            effort[pulse.joint] = pulse.effort_nm if now_s < turn_s else -pulse.effort_nm
        velocity_before = velocity
        velocity = solve @ (inertia_kgm2 @ velocity + dt * effort)
        position = position + 0.5 * dt * (velocity_before + velocity)
    return float(position[pulse.joint])
