"""What docs/arm-contract.md promises, on any implementation (see conftest.py)."""

from __future__ import annotations

import numpy as np
import pytest
from arm_under_test import TINY_SHARE, ArmUnderTest

from tel_ros.nodes.conversions import time_ns
from tel_ros.recording import topics

pytestmark = pytest.mark.timeout(90)

WATCHDOG_S = 0.1


def test_every_state_names_every_joint_once_with_a_finite_position(arm: ArmUnderTest) -> None:
    for state in arm.new_states(5):
        assert [list(state.name).count(joint) for joint in arm.joints] == [1] * len(arm.joints)
        assert len(state.position) == len(state.name)
        assert len(state.velocity) in (0, len(state.name))
        assert len(state.effort) in (0, len(state.name))
        assert np.isfinite(arm.position_rad(state)).all()


def test_states_are_published_reliably_by_one_and_commands_heard_by_one(arm: ArmUnderTest) -> None:
    publishers = arm.node.get_publishers_info_by_topic(topics.JOINT_STATES)
    listeners = arm.node.get_subscriptions_info_by_topic(arm.command_topic)
    assert [p.topic_type for p in publishers] == ["sensor_msgs/msg/JointState"]
    assert [p.qos_profile.reliability.name for p in publishers] == ["RELIABLE"]
    assert [p.topic_type for p in listeners] == ["std_msgs/msg/Float64MultiArray"]


def test_the_arm_stands_inside_its_range(arm: ArmUnderTest) -> None:
    position = arm.position_rad(arm.new_states(1)[0])
    assert np.all(position >= arm.config.arm.position_min_rad)
    assert np.all(position <= arm.config.arm.position_max_rad)


def test_stamps_never_go_back_and_equal_stamps_have_equal_contents(arm: ArmUnderTest) -> None:
    states = arm.new_states(5 if arm.lockstep else 20)
    for before, after in zip(states, states[1:], strict=False):
        step_ns = time_ns(after.header.stamp) - time_ns(before.header.stamp)
        assert step_ns >= 0
        if step_ns == 0:
            assert arm.lockstep, "a stamp is repeated"
            assert after == before


def test_one_period_passes_from_state_to_state(arm: ArmUnderTest) -> None:
    period_ns = 1e9 / arm.config.control.rate_hz
    if arm.lockstep:
        pairs = arm.answer(arm.rest, 10)
        assert {time_ns(state.header.stamp) - answered for answered, state in pairs} == {round(period_ns)}
        return
    steps_ns = np.diff([time_ns(state.header.stamp) for state in arm.new_states(100)])
    # On a busy machine a driver passes periods over; a state that is one period after another stays one.
    assert np.sum(np.abs(steps_ns / period_ns - 1.0) < 0.1) >= 10, steps_ns


def test_in_lockstep_time_stands_still_without_commands_and_else_it_does_not(arm: ArmUnderTest) -> None:
    stamps = {time_ns(state.header.stamp) for state in arm.new_states(5)}
    assert (len(stamps) == 1) is arm.lockstep


def test_a_state_never_feels_the_command_that_answers_it(arm: ArmUnderTest) -> None:
    """The effort shows up, but in no state with the stamp that was answered or an earlier one."""
    if arm.effort_nm(arm.states[-1]) is None:
        pytest.skip("the arm tells no effort")
    arm.answer(arm.rest, 3)
    start = len(arm.states)
    answered_ns, _ = arm.answer(arm.pushing(1.0))[0]
    for share in (1.0, 1.0, -1.0, -1.0):  # there and back: nothing keeps moving
        arm.answer(arm.pushing(share))
    arm.answer(arm.rest, 5)
    half = 0.5 * arm.tiny_nm[0]
    showing = [time_ns(s.header.stamp) for s in arm.states[start:] if arm.effort_nm(s)[0] > half]
    assert showing, "the effort never shows up in the states"
    assert min(showing) > answered_ns
    if arm.lockstep:
        assert min(showing) == answered_ns + round(1e9 / arm.config.control.rate_hz)


def test_in_lockstep_only_the_newest_state_can_be_answered(arm: ArmUnderTest) -> None:
    if not arm.lockstep:
        pytest.skip("only lockstep waits for answers")
    old_ns = arm.answer(arm.rest)[0][0]
    now_ns = arm.stamp_ns()
    arm.command(arm.pushing(1.0), old_ns)
    assert {time_ns(state.header.stamp) for state in arm.new_states(4)} == {now_ns}


def test_a_command_without_label_is_obeyed(arm: ArmUnderTest) -> None:
    before_ns = arm.stamp_ns()
    arm.command(arm.rest)
    arm.spin_until(lambda: arm.stamp_ns() > before_ns, 10.0, "the next state")


def test_the_effort_is_zero_within_100_ms_of_silence(arm: ArmUnderTest) -> None:
    if arm.lockstep:
        pytest.skip(
            "time stands still without commands; an arm that moves: test/graph/test_sim_bridge_node.py"
        )
    if arm.takes_positions:
        pytest.skip("position drives hold their last set point instead")
    if arm.effort_nm(arm.states[-1]) is None:
        pytest.skip("the arm tells no effort: tel check tells it from the motion")
    answered = arm.answer(arm.pushing(1.0), 5)[-1][0]
    last_ns = arm.stamp_ns()
    start = len(arm.states)
    arm.spin_until(lambda: arm.stamp_ns() > last_ns + 0.2e9, 10.0, "0.2 s of silence")
    arm.command(arm.rest)
    acting = [
        time_ns(s.header.stamp)
        for s in arm.states[start - 1 :]
        if max(map(abs, arm.effort_nm(s))) > 0.25 * min(arm.tiny_nm)
    ]
    assert acting, "the effort has not been there at all"
    period_s = 1.0 / arm.config.control.rate_hz
    assert (acting[-1] - last_ns) * 1e-9 <= WATCHDOG_S + 2.0 * period_s
    assert last_ns > answered


def test_position_drives_hold_the_last_set_point_in_silence(arm: ArmUnderTest) -> None:
    if not arm.takes_positions or arm.lockstep:
        pytest.skip("other arms let go; in lockstep time stands still without commands")
    set_point_rad = np.array(arm.pushing(1.0))
    distance_rad = np.abs(set_point_rad - arm.rest)
    arm.answer(set_point_rad.tolist())
    silent_since_ns = arm.stamp_ns()
    arm.spin_until(lambda: arm.stamp_ns() > silent_since_ns + 0.5e9, 20.0, "0.5 s of silence")
    held_rad = arm.position_rad(arm.states[-1])
    arm.settle()
    assert np.all(np.abs(held_rad - set_point_rad) < 0.5 * distance_rad)


def test_a_command_that_cannot_be_used_is_not_applied(arm: ArmUnderTest) -> None:
    if arm.is_precious:
        pytest.skip("asks for --hostile-commands")
    arm.settle()
    push = arm.pushing(1.0)
    for bad in (
        [float("nan"), *push[1:]],
        [*push[:-1], float("inf")],
        push[:-1],
        [*push, 0.1],
        [],
    ):
        start = len(arm.states)
        arm.command(bad)
        arm.new_states(5 if arm.lockstep else 10)  # repeated every 50 ms there
        for state in arm.states[start:]:
            assert np.isfinite(arm.position_rad(state)).all(), bad
            assert arm.is_still(state), bad
        assert arm.answer(arm.rest), f"it does not go on after {bad}"


def test_an_effort_beyond_the_limit_is_clipped(arm: ArmUnderTest) -> None:
    if arm.is_precious:
        pytest.skip("asks for --hostile-commands")
    limit_nm = np.array(arm.config.arm.effort_limit_nm)
    start = len(arm.states)
    efforts = np.zeros(0)
    for _ in range(5):  # a machine that stands still for a moment swallows so short a push
        arm.answer(arm.pushing(10.0 / TINY_SHARE), 3)
        arm.answer(arm.pushing(-10.0 / TINY_SHARE), 3)
        arm.answer(arm.rest, 3)
        efforts = np.array([arm.effort_nm(state) for state in arm.states[start:]])
        if efforts.any():
            break
    assert np.abs(efforts).max() == pytest.approx(limit_nm.max())
    assert np.all(np.abs(efforts) <= limit_nm + 1e-9)
