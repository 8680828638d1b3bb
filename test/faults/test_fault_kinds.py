"""What a fault campaign consists of, and what its faults do to messages."""

from __future__ import annotations

import math
import re
from array import array

import pytest
from fault_judge import EXPECTATIONS
from fault_kinds import KINDS
from fault_messages import Message
from fault_plan import batches, plan
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from tel_ros.nodes.conversions import time_ns, to_time


def state(number: int = 1) -> JointState:
    message = JointState(name=["a", "b"], position=array("d", [0.1 * number, 0.2]))
    message.velocity = array("d", [0.3 * number, 0.4])
    message.effort = array("d", [0.5, 0.6])
    message.header.stamp = to_time(number * 4_000_000)
    return message


def passed(kind: str, parameters: dict, n: int = 1) -> list[tuple[float, Message]]:
    made = KINDS[kind].corruption(parameters)
    return [out for k in range(1, n + 1) for out in made(state(k))]


def stamps(messages: list[tuple[float, Message]]) -> list[int]:
    return [time_ns(message.header.stamp) // 4_000_000 for _, message in messages]


def test_a_campaign_is_the_same_for_the_same_seed_and_another_for_another() -> None:
    assert plan(80, 1) == plan(80, 1)
    assert plan(80, 1) != plan(80, 2)


def test_a_longer_campaign_begins_with_the_shorter_one() -> None:
    assert plan(200, 1)[:60] == plan(60, 1)


def test_every_kind_comes_before_any_comes_again() -> None:
    assert {fault.kind for fault in plan(len(KINDS), 5)} == set(KINDS)


def test_what_is_asked_for_is_all_that_is_drawn() -> None:
    faults = plan(30, 1, ["state_nan", "kill_tel"], ["iiwa"])
    assert {fault.kind for fault in faults} == {"state_nan", "kill_tel"}
    assert {fault.setup for fault in faults} == {"iiwa"}


def test_each_fault_is_in_one_batch_and_only_the_last_of_a_batch_or_one_from_the_start_ends_the_run() -> None:
    faults = plan(300, 7)
    shared = batches(faults)
    assert sorted(fault.index for part in shared for fault in part) == [fault.index for fault in faults]
    for part in shared:
        assert len({fault.setup for fault in part}) == 1
        ends = [fault.kind for fault in part[:-1] if KINDS[fault.kind].ends_run]
        assert not ends or (ends == [part[0].kind] and KINDS[part[0].kind].window_s is None)


@pytest.mark.parametrize("name", sorted(KINDS))
def test_each_kind_says_what_is_right_for_whatever_is_drawn(name: str) -> None:
    kind = KINDS[name]
    re.compile(kind.says)
    faults = plan(20, 3, [name])
    assert {kind.expectation(fault.parameters) for fault in faults} <= set(EXPECTATIONS)
    assert {fault.setup for fault in faults} <= set(kind.setups)
    assert bool(kind.change) != bool(kind.act)


@pytest.mark.parametrize("name", [kind.name for kind in KINDS.values() if kind.change])
def test_each_fault_of_messages_changes_what_passes(name: str) -> None:
    (fault,) = plan(1, 1, [name])

    def made(k: int) -> Message:
        return state(k) if name.startswith("state") else Float64MultiArray(data=[float(k), 0.0])

    change = KINDS[name].corruption(fault.parameters)
    out = [result for k in range(1, 41) for result in change(made(k))]
    assert out != [(0.0, made(k)) for k in range(1, 41)]


@pytest.mark.parametrize(("kind", "is_it"), [("state_nan", math.isnan), ("state_inf", math.isinf)])
def test_one_joint_gets_a_number_that_is_none(kind: str, is_it: object) -> None:
    ((_, message),) = passed(kind, {"joint": 1})
    assert is_it(message.position[1])
    assert message.position[0] == 0.1


def test_reordered_messages_all_come_but_in_pairs_the_wrong_way_round() -> None:
    assert stamps(passed("state_reordered", {}, 6)) == [2, 1, 4, 3, 6, 5]


def test_a_repeating_channel_repeats_its_first_message() -> None:
    assert stamps(passed("state_repeated", {}, 3)) == [1, 1, 1]


def test_a_stuttering_channel_passes_every_nth_message() -> None:
    assert stamps(passed("state_stutter", {"every": 3}, 9)) == [3, 6, 9]


def test_nothing_comes_through_a_silent_channel() -> None:
    assert passed("state_silence", {}, 5) == []


def test_a_late_message_is_late_by_what_was_asked() -> None:
    assert [delay for delay, _ in passed("state_delayed", {"delay_s": 0.03}, 2)] == [0.03, 0.03]


def test_a_clock_that_jumps_moves_stamps_and_not_below_zero() -> None:
    assert stamps(passed("state_time_forward", {"shift_s": 0.4})) == [101]
    assert stamps(passed("state_time_back", {"shift_s": -1.0})) == [0]


def test_the_share_that_gets_lost_is_the_same_every_time() -> None:
    parameters = {"share": 0.5, "seed": 3}
    kept = stamps(passed("state_dropped", parameters, 200))
    assert kept == stamps(passed("state_dropped", parameters, 200))
    assert 70 < len(kept) < 130
