"""A check finds the fault of an arm, and nothing at an arm without one."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from synthetic_check import RoughArm, SyntheticCheck
from two_link import TwoLinkArm, arm_config

from tel_ros.core.check.checks import LISTENING, MOVING, judge, worst
from tel_ros.core.check.evidence import Evidence, Finding, UrdfModel, Verdict
from tel_ros.core.check.pulses import PulseBounds

RATE_HZ = 500.0
POSTURES = [(0.2, 0.5), (0.0, 2.0)]


def inertia(posture: tuple[float, float]) -> np.ndarray:
    """M of the arm, column by column from its inverse dynamics at rest."""
    rows, still = np.tile(posture, (2, 1)), np.zeros((2, 2))
    return TwoLinkArm(friction_nms_per_rad=0.0).inverse_dynamics(rows, still, np.eye(2)).T


@cache
def check(
    fault: str, posture: tuple[float, float] = (0.2, 0.5), bounds: PulseBounds | None = None, **rough: object
) -> tuple[SyntheticCheck, list[Finding]]:
    model = UrdfModel(inertia(posture), np.array([0.05, 0.05]))
    made = SyntheticCheck(RoughArm(fault, posture_rad=posture, **rough), bounds or PulseBounds(), model=model)
    listened = Evidence(arm_config(), RATE_HZ, made.listen())
    findings = judge(listened, [check for check in LISTENING if check.needs != "graph"])
    shown = made.pulse().shown()
    findings += judge(replace(listened, moving=made.states(), pulsed=shown), MOVING)
    return made, findings


def wrong(findings: list[Finding]) -> set[tuple[str, str]]:
    return {(f.check, f.joint) for f in findings if f.verdict is Verdict.WRONG}


def of(findings: list[Finding], name: str, joint: str = "") -> Finding:
    return next(f for f in findings if f.check == name and f.joint == joint)


@pytest.mark.parametrize("posture", POSTURES)
def test_nothing_is_wrong_with_an_arm_without_fault(posture: tuple[float, float]) -> None:
    _, findings = check("", posture)
    assert {f.verdict for f in findings} == {Verdict.OK}
    assert worst(findings) is Verdict.OK


@pytest.mark.parametrize("posture", POSTURES)
@pytest.mark.parametrize("fault", ["swapped_commands", "swapped_states"])
def test_swapped_joints_are_found_whatever_the_coupling(fault: str, posture: tuple[float, float]) -> None:
    _, findings = check(fault, posture)
    assert wrong(findings) == {("wiring", "shoulder"), ("wiring", "elbow")}
    assert of(findings, "wiring", "shoulder").measured == "its command moves elbow"


@pytest.mark.parametrize("posture", POSTURES)
@pytest.mark.parametrize(("fault", "joint"), [("flipped_effort", "elbow"), ("flipped_position", "shoulder")])
def test_a_flipped_sign_is_found(fault: str, joint: str, posture: tuple[float, float]) -> None:
    _, findings = check(fault, posture)
    assert wrong(findings) == {("sign of effort", joint)}


def test_degrees_are_found_by_the_posture_and_stop_the_pulses() -> None:
    made, findings = check("degrees")
    assert ("posture", "shoulder") in wrong(findings)
    assert "degrees" in of(findings, "posture", "shoulder").mend
    assert of(findings, "posture", "shoulder").blocks
    assert ("pulses", "") in wrong(findings)
    assert np.abs(np.array(made.arm.arm.q) - [0.2, 0.5]).max() < 0.002


def test_degrees_are_found_at_a_posture_that_could_be_radians() -> None:
    _, findings = check("degrees", (0.0, 0.0))
    assert ("posture", "shoulder") not in wrong(findings)
    assert "degrees" in of(findings, "pulses").mend
    assert "steps of 0.00549 rad" in of(findings, "pulses").measured


def test_a_velocity_in_degrees_is_found() -> None:
    _, findings = check("degrees_velocity")
    assert wrong(findings) == {("velocity", "shoulder"), ("velocity", "elbow")}
    assert "degrees/s" in of(findings, "velocity", "elbow").mend


def test_stamps_that_stand_still_are_found_and_keep_the_arm_from_being_moved() -> None:
    _, findings = check("stale_stamps")
    assert {("order of stamps", ""), ("rate of stamps", ""), ("age of states", "")} <= wrong(findings)
    assert of(findings, "order of stamps").blocks


def test_states_that_come_late_are_found_by_their_age_and_by_the_delay() -> None:
    _, findings = check("late_states")
    assert {("age of states", ""), ("round-trip delay", "")} <= wrong(findings)
    assert of(findings, "age of states").measured.startswith("40.3 ms")
    assert of(findings, "age of states").blocks


def test_20_ms_of_delay_are_found_and_measured() -> None:
    _, findings = check("command_delay")
    assert wrong(findings) == {("round-trip delay", "")}
    assert float(of(findings, "round-trip delay").measured.split()[0]) == pytest.approx(20.0, abs=2.5)


def test_a_dead_effort_channel_is_found_and_the_other_joint_is_not_blamed() -> None:
    _, findings = check("dead_channel")
    assert wrong(findings) == {("effort channel", "shoulder")}
    assert of(findings, "effort channel", "shoulder").measured == "nothing moves at ±0.4 N·m"


@pytest.mark.parametrize("fault", ["no_watchdog", "no_watchdog_no_effort_field"])
def test_a_driver_that_goes_on_pushing_without_commands_is_found(fault: str) -> None:
    _, findings = check(fault)
    assert wrong(findings) == {("watchdog of the driver", "")}


@pytest.mark.parametrize(("watchdog_s", "verdict"), [(0.02, Verdict.OK), (0.05, Verdict.WARNING)])
def test_a_watchdog_that_lets_commands_stutter_is_warned_about(watchdog_s: float, verdict: Verdict) -> None:
    _, findings = check("", watchdog_s=watchdog_s)
    watchdog = of(findings, "watchdog of the driver")
    assert watchdog.verdict is verdict
    assert watchdog.expected.endswith("better within 20 ms")


def test_without_an_effort_field_the_watchdog_is_told_from_the_motion() -> None:
    _, findings = check("no_effort_field")
    assert worst(findings) is Verdict.WARNING
    assert of(findings, "efforts").verdict is Verdict.WARNING
    watchdog = of(findings, "watchdog of the driver")
    assert watchdog.verdict is Verdict.OK
    assert "by the motion" in watchdog.measured


def test_an_effort_in_other_units_is_found_as_far_as_it_does_too_much() -> None:
    _, findings = check("effort_in_percent")
    assert wrong(findings) == {("effort scale", "shoulder"), ("effort scale", "elbow")}
    _, findings = check("weak_effort")
    assert wrong(findings) == set()
    assert of(findings, "effort scale", "elbow").verdict is Verdict.WARNING


def step_of(bits: int) -> float:
    return 2.0 * np.pi / 2**bits


@pytest.mark.parametrize(("bits", "coulomb_nm"), [(12, 0.15), (11, 0.0)])
def test_a_coarse_encoder_gets_longer_pulses_and_is_no_fault(bits: int, coulomb_nm: float) -> None:
    made, findings = check("", encoder_rad=step_of(bits), differences=True, coulomb_nm=coulomb_nm)
    assert wrong(findings) == set()
    for joint in ("shoulder", "elbow"):
        for name in ("effort channel", "wiring", "sign of effort"):
            assert of(findings, name, joint).verdict is Verdict.OK
    assert max(pulse.turn_s - pulse.start_s for pulse in made.session.pulses) > 0.051
    assert np.abs(made.states().position_rad - [0.2, 0.5]).max() < 0.05


def test_motion_below_four_steps_of_the_encoder_is_said_and_not_taken_for_a_dead_drive() -> None:
    _, findings = check("", encoder_rad=step_of(12), coulomb_nm=0.3)
    shoulder = of(findings, "effort channel", "shoulder")
    assert shoulder.verdict is Verdict.NOT_CHECKED
    assert re.fullmatch(
        r"because shoulder moves by [\d.]+ mrad at ±0\.4 N·m; 6\.1 mrad are needed \(steps of 1\.5 mrad\)",
        shoulder.measured,
    )
    assert ("effort channel", "shoulder") not in wrong(findings)


def test_an_encoder_that_is_too_coarse_for_the_range_is_told_how_much_range_it_needs() -> None:
    _, findings = check("", encoder_rad=step_of(10))
    assert "steps of 0.00614 rad, too coarse" in of(findings, "pulses").measured
    assert "--range 0.061 or more" in of(findings, "pulses").mend
    _, findings = check("", encoder_rad=step_of(10), bounds=PulseBounds(effort_share=0.05, range_rad=0.08))
    assert wrong(findings) == set()


def test_dry_friction_leaves_the_delay_to_the_effort_field_or_to_nobody() -> None:
    _, findings = check("", coulomb_nm=0.15)
    delay = of(findings, "round-trip delay")
    assert delay.verdict is Verdict.OK
    assert delay.measured == "2.0 ms (2.0 to 2.0 ms in 12 cases) by the effort field"
    _, findings = check("no_effort_field", coulomb_nm=0.15)
    delay = of(findings, "round-trip delay")
    assert delay.verdict is Verdict.NOT_CHECKED
    assert "dry friction?" in delay.measured
    assert not re.search(r"-\d", delay.measured)


def test_a_delay_that_the_effort_field_hides_is_found_in_the_motion() -> None:
    made = SyntheticCheck(RoughArm("command_delay"))
    listened = Evidence(arm_config(), RATE_HZ, made.listen())
    shown = made.pulse().shown()
    honest = shown.pulses[0].states.effort_nm
    echoes = [
        replace(p, states=replace(p.states, effort_nm=np.roll(p.states.effort_nm, -10, axis=0)))
        for p in shown.pulses
    ]
    assert not np.array_equal(echoes[0].states.effort_nm, honest)
    evidence = replace(listened, moving=made.states(), pulsed=replace(shown, pulses=echoes))
    delay = of(judge(evidence, MOVING), "round-trip delay")
    assert delay.verdict is Verdict.WRONG
    assert "by the motion" in delay.measured
    assert "by the effort field" in delay.measured


@pytest.mark.parametrize(("cogging_nm", "off_rad"), [(0.1, 0.005), (0.3, 0.0), (0.3, 0.005)])
def test_cogging_is_no_fault(cogging_nm: float, off_rad: float) -> None:
    posture = (np.pi / 20 + off_rad, 3 * np.pi / 20 + off_rad)  # at rest between two cogs, or nearly so
    _, findings = check("", posture, cogging_nm=cogging_nm, coulomb_nm=0.03)
    assert {(f.check, f.joint) for f in findings if f.verdict is not Verdict.OK} <= {
        ("effort scale", "shoulder"),
        ("effort scale", "elbow"),
    }


@pytest.mark.parametrize("fault", ["swapped_commands", "swapped_states"])
def test_joints_that_do_not_answer_their_own_command_say_nothing_on_delay_and_watchdog(fault: str) -> None:
    _, findings = check(fault, watchdog_s=9.0)
    for name in ("round-trip delay", "watchdog of the driver"):
        assert of(findings, name).verdict is Verdict.NOT_CHECKED
    assert of(findings, "effort scale", "elbow").measured == "because its command moves shoulder"


def test_a_dead_joint_leaves_delay_and_watchdog_to_the_other_and_the_rest_unchecked() -> None:
    _, findings = check("dead_channel")
    assert of(findings, "round-trip delay").measured.startswith("2.0 ms")
    assert of(findings, "watchdog of the driver").verdict is Verdict.OK
    for name in ("wiring", "sign of effort", "effort scale"):
        assert (
            of(findings, name, "shoulder").measured == "because it has not moved clearly when it was pushed"
        )
    assert of(findings, "effort channel", "shoulder").mend.startswith("the drive reports no such effort")


def test_noise_of_the_positions_is_no_motion() -> None:
    _, findings = check("", noise_rad=1e-3)
    assert wrong(findings) == set()


def test_the_reason_why_no_inertia_is_known_is_passed_on() -> None:
    made = SyntheticCheck(RoughArm(), model=UrdfModel(None, np.zeros(2), "the URDF gives no mass"))
    evidence = Evidence(
        arm_config(), RATE_HZ, made.listen(), moving=made.states(), pulsed=made.pulse().shown()
    )
    assert of(judge(evidence, MOVING), "effort scale", "elbow").measured == "because the URDF gives no mass"
