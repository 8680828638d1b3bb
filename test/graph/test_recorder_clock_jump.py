"""A clock that jumps in mid-trial is no reason to take recorded ticks for lost ones."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
import rclpy
from rclpy.serialization import serialize_message
from tel_interfaces.msg import ControlState, TrialResult

from tel_ros.core.types import NS_PER_S
from tel_ros.nodes.conversions import to_time
from tel_ros.nodes.trial_recorder import TrialRecorderNode
from tel_ros.recording import topics
from tel_ros.recording.bag_writer import TrialBagWriter


@pytest.fixture
def recorder(tmp_path: Path) -> Iterator[TrialRecorderNode]:
    """Return the node in this process, with an open bag; nothing spins it."""
    rclpy.init()
    node = TrialRecorderNode()
    node._writer = TrialBagWriter(tmp_path / "trial_001", {})
    node._stamps = {topic: [] for topic in topics.RECORDED_LIVE}
    yield node
    node.destroy_node()
    rclpy.try_shutdown()


def tick(recorder: TrialRecorderNode, time_s: float, trial: int = 1) -> None:
    state = ControlState(trial=trial)
    state.header.stamp = to_time(round(time_s * NS_PER_S))
    recorder._record(topics.CONTROL_STATES, serialize_message(state))


def result(ticks: int, start_s: float, end_s: float) -> TrialResult:
    stamps = {
        "start_stamp": to_time(round(start_s * NS_PER_S)),
        "end_stamp": to_time(round(end_s * NS_PER_S)),
    }
    return TrialResult(index=1, ticks=ticks, **stamps)


@pytest.mark.parametrize("jump_s", [-5.0, 5.0])
def test_all_ticks_have_arrived_although_the_clock_has_jumped(
    recorder: TrialRecorderNode, jump_s: float
) -> None:
    stamps = [10.0, 10.1, 10.2, 10.3 + jump_s, 10.4 + jump_s, 10.5]
    for stamp in stamps:
        tick(recorder, stamp)
    assert recorder._dropped(result(len(stamps), stamps[0], stamps[-1])) == 0


def test_a_tick_that_did_not_arrive_is_missed(recorder: TrialRecorderNode) -> None:
    for stamp in (10.0, 10.1, 10.3):
        tick(recorder, stamp)
    assert recorder._dropped(result(4, 10.0, 10.3)) == 1


def test_neither_repetitions_nor_other_trials_count(recorder: TrialRecorderNode) -> None:
    for stamp, trial in ((9.9, 0), (10.0, 1), (10.0, 1), (10.1, 1), (10.2, 0), (10.3, 2)):
        tick(recorder, stamp, trial)
    assert recorder._dropped(result(2, 10.0, 10.1)) == 0
    assert recorder._dropped(result(3, 10.0, 10.2)) == 1
