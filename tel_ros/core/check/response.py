"""Which joint moved when which was pushed, which way, and how far."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.optimize import linear_sum_assignment

from tel_ros.core.check.findings import Finding, Verdict, judged
from tel_ros.core.check.records import Pulse
from tel_ros.core.types import FloatArray, IntArray

SCALE_TOLERANCE = 3.0
"""Factor by which an arm may move more or less than its URDF says."""
_DEGREES = math.degrees(1.0)
_STEP_S = 1e-3


def response_matrix(pulses: Sequence[Pulse], n_joints: int) -> FloatArray:
    """Return how far joint i goes when joint j is pushed, per N·m: row i, column j."""
    result = np.zeros((n_joints, n_joints))
    for joint in range(n_joints):
        own = [pulse for pulse in pulses if pulse.joint == joint]
        if own:
            result[:, joint] = np.mean([p.displacement_rad() / p.effort_nm for p in own], axis=0)
    return result


def wiring(response: FloatArray, moved: Sequence[int]) -> IntArray:
    """Return which joint each pushed joint is in truth: the column's own number if the wiring is right.

    The response of a rightly wired arm is that of its inverse inertia, which is symmetric and positive
    definite. The product of the diagonal of such a matrix exceeds that over any other permutation, since
    |A_ij| < √(A_ii A_jj); scaling rows and columns (units, efforts) changes nothing about that. So the
    permutation with the largest product tells the wiring, without a model. That a joint moves most when it is
    pushed itself would be a wrong rule: a light forearm moves more than the shoulder that is pushed.

    Args:
        response: shape (n_joints, n_joints).
        moved: the columns in which something moved.
    """
    size = np.log(np.maximum(np.abs(response[np.ix_(moved, moved)]), 1e-12))
    rows, columns = linear_sum_assignment(size.T, maximize=True)
    result = np.arange(len(response))
    result[np.array(moved, dtype=int)[rows]] = np.array(moved, dtype=int)[columns]
    return result


def judge_wiring(pulses: Sequence[Pulse], visible_rad: FloatArray, joints: Sequence[str]) -> list[Finding]:
    """Judge whether each effort reaches its joint, and with the right sign."""
    moved = [
        j
        for j in range(len(joints))
        if any(np.any(np.abs(p.displacement_rad()) >= visible_rad) for p in pulses if p.joint == j)
    ]
    response = response_matrix(pulses, len(joints))
    target = wiring(response, moved) if moved else np.arange(len(joints))
    findings = []
    for j, joint in enumerate(joints):
        own = [pulse for pulse in pulses if pulse.joint == j]
        if not own:
            text = "no pulse was sent to it"
            findings.append(
                Finding("effort channel", Verdict.NOT_CHECKED, text, "the joint moves", "", joint)
            )
            continue
        effort_nm = max(abs(pulse.effort_nm) for pulse in own)
        findings.append(
            judged(
                "effort channel",
                j in moved,
                f"{'moves' if j in moved else 'nothing moves'} at ±{effort_nm:.3g} N·m",
                "the joint moves",
                "is the drive on and the effort controller active? More friction than that: raise "
                "--effort-share",
                joint=joint,
            )
        )
        if j not in moved:
            continue
        i = int(target[j])
        findings.append(
            judged(
                "wiring",
                i == j,
                f"its command moves {joints[i]}" if i != j else "its command moves this joint",
                "its command moves this joint",
                f"{joint} and {joints[i]} are swapped: compare the joints of the effort controller and the "
                "names in the joint states with arm.joints, and the cables of the drives",
                joint=joint,
            )
        )
        findings += _judge_sign(own, response[i, j], i, j, joint)
    return findings


def judge_scale(
    pulses: Sequence[Pulse], expected_rad: Sequence[float], joints: Sequence[str]
) -> list[Finding]:
    """Judge how far joints went against what rigid links with the inertia of the URDF would have done.

    Args:
        pulses: of joints that have moved and are wired rightly.
        expected_rad: by :func:`expected_displacement`, one for each pulse.
        joints: names.
    """
    findings = []
    for j, joint in enumerate(joints):
        ratios = [
            float(p.displacement_rad()[j]) / expected
            for p, expected in zip(pulses, expected_rad, strict=True)
            if p.joint == j and expected != 0.0
        ]
        if not ratios:
            continue
        ratio = float(np.median(np.abs(ratios)))
        high = ratio > SCALE_TOLERANCE
        mend = "friction that is not in the URDF, a brake, or efforts that are not N·m at the joint"
        if high:
            mend = "efforts have to be N·m at the joint (gear ratio, current, percent?), positions rad"
            if 0.5 * _DEGREES < ratio < 2.0 * _DEGREES:
                mend = "the positions are probably degrees instead of radians: convert them in the driver"
        findings.append(
            judged(
                "effort scale",
                1.0 / SCALE_TOLERANCE <= ratio <= SCALE_TOLERANCE,
                f"moves {ratio:.3g} times as far as by the URDF",
                f"{1 / SCALE_TOLERANCE:.2g} to {SCALE_TOLERANCE:g}",
                mend,
                joint=joint,
                otherwise=Verdict.WRONG if high else Verdict.WARNING,
            )
        )
    return findings


def expected_displacement(pulse: Pulse, inertia_kgm2: FloatArray, damping_nms_per_rad: FloatArray) -> float:
    """Return how far the pushed joint goes in rad if M q̈ + D q̇ = τ, without gravity and dry friction.

    Args:
        pulse: the effort and how long it acted.
        inertia_kgm2: M at the posture. Shape (n_joints, n_joints).
        damping_nms_per_rad: D. Shape (n_joints,).
    """
    factor = pulse.arm_time_factor()
    turn_s, zero_s, duration_s = (
        factor * (at_s - pulse.start_s) for at_s in (pulse.turn_s, pulse.zero_s, pulse.end_s)
    )
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


def _judge_sign(own: list[Pulse], slope: float, moving: int, pushed: int, joint: str) -> list[Finding]:
    sign = judged(
        "sign of effort",
        slope > 0.0,
        "moves with the effort" if slope > 0.0 else "moves against the effort",
        "moves with the effort",
        "flip the sign of the effort, or of position and velocity, in the driver (if not all joints were "
        "pulsed, it may also be swapped with another)",
        joint=joint,
    )
    ways = [abs(float(p.displacement_rad()[moving])) for p in own]
    if moving != pushed or len(ways) < 2 or min(ways) > 0.2 * max(ways):
        return [sign]
    text = "moves one way only"
    mend = "it leans on a support or stop, or gravity is stronger: lay the arm where it is free"
    return [sign, Finding("both ways", Verdict.WARNING, text, "moves both ways", mend, joint)]
