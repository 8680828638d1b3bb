"""All judgements in the order in which a person reads them."""

from __future__ import annotations

import numpy as np

from tel_ros.core.check.bounds import Guard
from tel_ros.core.check.effort_field import judge_effort_field, judge_quantisation, judge_watchdog
from tel_ros.core.check.findings import Finding, Verdict
from tel_ros.core.check.listening import judge_age, judge_posture, judge_rate, judge_stamps, judge_values
from tel_ros.core.check.records import StateRecord
from tel_ros.core.check.response import expected_displacement, judge_scale, judge_wiring
from tel_ros.core.check.session import PulseSession
from tel_ros.core.check.timing import judge_delay
from tel_ros.core.check.velocity import judge_velocity
from tel_ros.core.config import ArmConfig
from tel_ros.core.types import FloatArray


def judge_listening(
    states: StateRecord, arm: ArmConfig, rate_hz: float, *, arm_has_own_clock: bool
) -> list[Finding]:
    """Judge what an arm says that nobody commands.

    Args:
        states: at least one.
        arm: its limits have been filled.
        rate_hz: configured rate.
        arm_has_own_clock: see :func:`~tel_ros.core.check.listening.judge_age`.
    """
    values = judge_values(states)
    findings = [
        *judge_rate(states, rate_hz),
        judge_stamps(states),
        judge_age(states, arm_has_own_clock=arm_has_own_clock),
        *values,
    ]
    if not any(finding.blocks for finding in values):
        findings += judge_posture(states, arm)
    return findings


def judge_pulses(
    session: PulseSession,
    guard: Guard,
    states: StateRecord,
    arm: ArmConfig,
    rate_hz: float,
    inertia_kgm2: FloatArray | None,
    friction_nms_per_rad: FloatArray,
) -> list[Finding]:
    """Judge what an arm did when it was pulsed.

    Args:
        session: that sent the pulses.
        guard: of the session.
        states: everything that was heard meanwhile.
        arm: names and limits.
        rate_hz: configured rate.
        inertia_kgm2: of the URDF at this posture, shape (n_joints, n_joints); None: not known.
        friction_nms_per_rad: viscous, of the URDF. Shape (n_joints,).
    """
    joints, pulses, visible_rad = arm.joints, session.pulses, session.visible_rad
    findings = []
    if guard.complaint is not None:
        expected = "all pulses within the allowed range"
        text = f"ended early: {guard.complaint}"
        findings.append(Finding("pulses", Verdict.WRONG, text, expected, guard.mend))
    tried = {pulse.joint for pulse in pulses}
    wiring = judge_wiring(pulses, visible_rad, joints)
    findings += wiring
    wrong = {
        f.joint for f in wiring if f.verdict is not Verdict.OK and f.check in ("effort channel", "wiring")
    }
    sound = [pulse for pulse in pulses if joints[pulse.joint] not in wrong]
    if inertia_kgm2 is None:
        text, expected = "the URDF's inertia is not known (pip install pin)", "as the URDF says"
        findings.append(Finding("effort scale", Verdict.NOT_CHECKED, text, expected))
    else:
        goes = [expected_displacement(pulse, inertia_kgm2, friction_nms_per_rad) for pulse in sound]
        findings += judge_scale(sound, goes, joints)
    findings.append(judge_delay(pulses, visible_rad, rate_hz))
    findings += [f for f in judge_effort_field(pulses, joints) if joints.index(f.joint) in tried]
    findings += judge_quantisation(states, arm)
    findings.append(judge_watchdog(session.silence, rate_hz))
    return findings + [f for f in judge_velocity(states) if np.isfinite(states.position_rad).all()]
