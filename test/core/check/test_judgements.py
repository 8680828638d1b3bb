"""Single judgements on made-up records."""

from __future__ import annotations

import numpy as np
import pytest
from two_link import arm_config

from tel_ros.core.check.checks import LISTENING, MOVING, Check, worst
from tel_ros.core.check.evidence import (
    Evidence,
    Finding,
    Pulse,
    Pulsed,
    StateRecord,
    UrdfModel,
    Verdict,
    judged,
)
from tel_ros.core.check.response import assignment

JOINTS = ("shoulder", "elbow")
COLUMNS = ("received_s", "stamp_ns", "age_s", "position_rad", "velocity_rad_s", "effort_nm")
STATES = [("broadcaster", "sensor_msgs/msg/JointState", "reliable")]
LISTENER = [("effort_controller", "std_msgs/msg/Float64MultiArray", "reliable")]


def record(n: int = 200, period_s: float = 0.002, age_s: float = 0.001, **columns: np.ndarray) -> StateRecord:
    time_s = 10.0 + period_s * np.arange(n)
    zero = np.zeros((n, 2))
    values = {
        "received_s": time_s,
        "stamp_ns": np.round((time_s - age_s) * 1e9).astype(np.int64),
        "age_s": np.full(n, age_s),
        "position_rad": zero,
        "velocity_rad_s": zero,
        "effort_nm": zero,
    }
    return StateRecord(JOINTS, **(values | columns))


def found(*titles: str, rate_hz: float = 500.0, **known: object) -> list[Finding]:
    """Return the findings of some checks, in the order of the list."""
    evidence = Evidence(**({"arm": arm_config(), "rate_hz": rate_hz, "states": record()} | known))
    return [
        finding
        for check in (*LISTENING, *MOVING)
        if check.title in titles
        for finding in check.findings(evidence)
    ]


def bad(findings: list[Finding]) -> list[str]:
    return [f.check for f in findings if f.verdict is Verdict.WRONG]


@pytest.mark.parametrize(
    ("rate_hz", "expected"), [(500.0, []), (1000.0, ["rate of states", "rate of stamps"])]
)
def test_the_rate_has_to_be_the_configured_one(rate_hz: float, expected: list[str]) -> None:
    assert bad(found("rate of states", "rate of stamps", rate_hz=rate_hz)) == expected


def test_uneven_arrival_is_a_warning() -> None:
    late_s = np.where(np.arange(200) % 10 == 0, 0.012, 0.0)
    bunched_s = np.maximum.accumulate(record().received_s + late_s)
    (jitter,) = found("jitter of arrival", states=record(received_s=bunched_s))
    assert jitter.check == "jitter of arrival"
    assert jitter.verdict is Verdict.WARNING


def test_stamps_that_go_back_are_found() -> None:
    stamps = record().stamp_ns.copy()
    stamps[50:] -= 100_000_000
    (finding,) = found("order of stamps", states=record(stamp_ns=stamps))
    assert finding.verdict is Verdict.WRONG
    assert finding.measured == "1 of 199 steps go back, 0 repeat a stamp"


def test_stamps_of_zero_are_not_taken_for_clocks_that_differ() -> None:
    unset = record(age_s=1.7e9, stamp_ns=np.zeros(200, dtype=np.int64))
    (finding,) = found("age of states", states=unset)
    assert "has to set the stamps, which are all 0" in finding.mend
    (finding,) = found("age of states", states=record(age_s=1e3))
    assert "synchronise the clocks" in finding.mend


@pytest.mark.parametrize(("age_s", "good"), [(0.001, True), (0.019, True), (0.03, False), (-0.02, False)])
def test_old_states_and_states_of_the_future_are_found(age_s: float, good: bool) -> None:
    (finding,) = found("age of states", states=record(age_s=age_s))
    assert (finding.verdict is Verdict.OK) is good
    (own,) = found("age of states", states=record(age_s=age_s), arm_has_own_clock=True)
    assert own.verdict is Verdict.NOT_CHECKED


def test_a_position_that_is_no_number_blocks_and_a_missing_velocity_warns() -> None:
    position, velocity = np.zeros((200, 2)), np.zeros((200, 2))
    position[7, 1], velocity[:, 0] = np.nan, np.nan
    states = record(position_rad=position, velocity_rad_s=velocity)
    findings = found("positions", "velocities", "efforts", "posture", states=states)
    assert bad(findings) == ["positions"]
    assert findings[0].blocks
    assert findings[0].measured == "not finite: elbow"
    assert findings[1].measured == "missing: shoulder"


def test_a_posture_out_of_range_blocks() -> None:
    position = np.zeros((200, 2))
    position[:, 1] = 3.0
    findings = found("posture", states=record(position_rad=position))
    assert [f.blocks for f in findings] == [False, True]


@pytest.mark.parametrize(("factor", "good"), [(1.0, True), (57.3, False), (-1.0, False), (0.5, False)])
def test_a_velocity_has_to_be_the_derivative_of_the_position(factor: float, good: bool) -> None:
    time_s = 0.002 * np.arange(1000)
    position = np.column_stack([np.sin(time_s), np.zeros(1000)])
    velocity = factor * np.column_stack([np.cos(time_s), np.zeros(1000)])
    moving, still = found("velocity", moving=record(1000, position_rad=position, velocity_rad_s=velocity))
    assert (moving.verdict is Verdict.OK) is good
    assert still.verdict is Verdict.NOT_CHECKED


def test_a_velocity_that_is_late_by_a_filter_is_still_right() -> None:
    time_s = 0.002 * np.arange(1000)
    position = np.column_stack([np.sin(3 * time_s)] * 2)
    velocity = np.column_stack([3 * np.cos(3 * (time_s - 0.005))] * 2)
    assert bad(found("velocity", moving=record(1000, position_rad=position, velocity_rad_s=velocity))) == []


@pytest.mark.parametrize("rate_hz", [50.0, 100.0, 500.0])
def test_a_steady_motion_is_not_taken_for_noise_of_the_position(rate_hz: float) -> None:
    time_s = np.arange(round(2.0 * rate_hz)) / rate_hz
    position, velocity = (np.column_stack([values] * 2) for values in (np.sin(time_s), np.cos(time_s)))
    states = record(len(time_s), 1.0 / rate_hz, position_rad=position, velocity_rad_s=velocity)
    assert {finding.verdict for finding in found("velocity", moving=states)} == {Verdict.OK}


@pytest.mark.parametrize("moves", [False, True])
def test_noise_of_the_position_is_told_whether_a_joint_moves_or_not(moves: bool) -> None:
    noise_rad = 1e-3 * np.random.default_rng(3).normal(size=(2000, 2))
    ramp_rad = np.outer(np.linspace(0.0, 20.0, 2000), [1.0, 1.0])
    resolution_rad = record(2000, position_rad=noise_rad + moves * ramp_rad).resolution_rad()
    # The median of the difference of two such values.
    assert resolution_rad == pytest.approx([0.954e-3] * 2, rel=0.1)


def test_the_steps_of_an_encoder_are_told_in_single_precision_too() -> None:
    quantum_rad = 1e-3
    counts = np.cumsum(np.concatenate([np.zeros(1000), np.random.default_rng(1).integers(1, 4, 500)]))
    position = np.column_stack([(2.0 + quantum_rad * counts).astype(np.float32)] * 2).astype(np.float64)
    assert record(1500, position_rad=position).resolution_rad() == pytest.approx([quantum_rad] * 2, rel=1e-3)


def test_a_joint_whose_states_were_lost_while_it_moved_is_not_said_to_have_hardly_moved() -> None:
    time_s = 0.002 * np.arange(1000)
    position = np.column_stack([np.sin(time_s), np.zeros(1000)])
    velocity = np.column_stack([np.cos(time_s), np.zeros(1000)])
    whole = record(1000, position_rad=position, velocity_rad_s=velocity)
    heard = np.concatenate([whole.between(a, a + 0.06).received_s for a in (10.0, 10.6, 11.2)])
    kept = np.isin(whole.received_s, heard[: -len(heard) // 3])
    lost = StateRecord(JOINTS, *(getattr(whole, name)[kept] for name in COLUMNS))
    moved, still = found("velocity", moving=lost)
    assert (moved.verdict, still.verdict) == (Verdict.NOT_CHECKED, Verdict.NOT_CHECKED)
    assert moved.measured == "because it has moved clearly 2 times, at least 3 are needed"
    assert "states missing" in moved.mend
    assert still.measured.startswith("because the joint has hardly moved: 0 mrad within 200 ms, ")


def test_a_coarse_effort_is_a_warning() -> None:
    effort = np.round(np.column_stack([np.linspace(-2, 2, 200)] * 2) / [0.5, 0.01]) * [0.5, 0.01]
    findings = found("effort steps", moving=record(effort_nm=effort))
    assert [f.verdict for f in findings] == [Verdict.WARNING, Verdict.OK]


@pytest.mark.parametrize(
    ("back_rad", "expected"),
    [
        (-0.006, []),  # dry friction and cogging make one way shorter
        (0.0, ["moves 10 mrad with the push one way and 0 mrad the other"]),
        (0.008, ["moves 10 mrad with the push one way and -8 mrad the other"]),
    ],
)
def test_a_joint_that_leans_on_a_stop_or_falls_is_told_from_one_that_moves_less_one_way(
    back_rad: float, expected: list[str]
) -> None:
    def pulse(effort_nm: float, elbow_rad: float) -> Pulse:
        way = np.interp(np.arange(100), [15, 65], [0.0, 1.0])
        states = record(100, position_rad=np.outer(way, [0.0, elbow_rad]))
        return Pulse(1, effort_nm, 10.03, 10.08, 10.13, 10.19, states)

    lengths = (np.full(2, 1e-6), np.full(2, 1e-4), np.full(2, 4e-4))
    shown = Pulsed(
        [pulse(0.4, 0.01), pulse(-0.4, back_rad)], None, *lengths, "", "", UrdfModel(None, np.zeros(2))
    )
    findings = found("both ways", pulsed=shown)
    assert [f.measured for f in findings] == expected
    assert {f.verdict for f in findings} <= {Verdict.WARNING}


@pytest.mark.parametrize("seed", range(20))
def test_any_wiring_of_seven_joints_is_recognised_in_any_units(seed: int) -> None:
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(7, 7))
    response = root @ root.T + 0.3 * np.eye(7)
    order = rng.permutation(7)
    units = rng.uniform(0.01, 100.0, 7)
    wired = units[:, None] * response[:, order] * rng.choice([-1.0, 1.0], 7)
    assert assignment(wired).tolist() == order.tolist()


@pytest.mark.parametrize(
    ("states", "commanders", "listeners", "expected"),
    [
        (STATES, [], LISTENER, []),
        (STATES * 2, [], LISTENER, ["publisher of states"]),
        (STATES, LISTENER, LISTENER, ["other commands"]),
        (STATES, [], [], ["listener to commands"]),
        (STATES, [], LISTENER * 2, ["listener to commands"]),
        ([(*STATES[0][:2], "best_effort")], [], LISTENER, ["quality of service"]),
    ],
)
def test_one_arm_has_one_publisher_one_listener_and_nobody_else(
    states: list, commanders: list, listeners: list, expected: list[str]
) -> None:
    titles = ("publisher of states", "other commands", "listener to commands", "quality of service")
    graph = {"publishers": states, "commanders": commanders, "listeners": listeners}
    assert bad(found(*titles, **graph)) == expected


def test_a_controller_of_trajectories_has_to_take_trajectories() -> None:
    taken = [("joint_trajectory_controller", "trajectory_msgs/msg/JointTrajectory", "reliable")]
    arm = arm_config(command_interface="trajectory")
    assert bad(found("listener to commands", listeners=taken, arm=arm)) == []
    assert bad(found("listener to commands", listeners=LISTENER, arm=arm)) == ["listener to commands"]


def test_names_that_are_missing_or_there_twice_are_found_and_others_ignored() -> None:
    def named(*names: tuple[str, ...], malformed: int = 0) -> list[Finding]:
        return found("name", "fields", names=names, malformed=malformed)

    assert bad(named(("finger", "elbow", "shoulder"))) == []
    missing = named(("schulter", "elbow"))
    assert [f.verdict is Verdict.WRONG for f in missing] == [True, False]
    assert missing[0].measured == "in none (others: schulter)"
    assert bad(named(("elbow", "shoulder", "elbow"))) == ["name"]
    assert bad(named(("elbow",), ("shoulder", "elbow"))) == ["name"]
    assert bad(named(("elbow", "shoulder"), malformed=3)) == ["fields"]


def test_too_few_states_are_said_and_not_judged() -> None:
    (finding,) = found("states", "rate of states", "posture", states=record(19), listened_s=2.0)
    assert (finding.check, finding.measured) == ("states", "19 states with all joints in 2 s")
    assert finding.blocks


def test_each_check_has_a_title_of_its_own() -> None:
    titles = [check.title for check in (*LISTENING, *MOVING)]
    assert len(set(titles)) == len(titles)


def test_the_verdict_is_the_worst_finding_and_only_wrong_ones_block() -> None:
    fine = judged(True, "", "", "mend it")
    warning = judged(False, "", "", "mend it", Verdict.WARNING)
    wrong = judged(False, "", "", "mend it")
    evidence = Evidence(arm_config(), 500.0, record())
    blocked = [
        Check("", "graph", lambda _, f=f: f, blocks=True).findings(evidence) for f in (fine, warning, wrong)
    ]
    assert [findings[0].blocks for findings in blocked] == [False, False, True]
    assert fine.mend == ""
    assert worst([fine]) is Verdict.OK
    assert worst([fine, warning]) is Verdict.WARNING
    assert worst([warning, judged(False, "", "", "")]) is Verdict.WRONG
