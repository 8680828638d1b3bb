"""One recording from start to stop, in this process; nothing spins the node, and nothing waits."""

from __future__ import annotations

import resource
from collections.abc import Callable, Coroutine, Iterator
from pathlib import Path
from typing import Any

import pytest
import rclpy
import yaml
from rclpy.serialization import serialize_message
from rosbags.highlevel import AnyReader
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, MultiArrayDimension
from tel_interfaces.msg import ControlState, TrialGoal, TrialResult
from tel_interfaces.srv import StartRecording, StopRecording

from tel_ros.core.types import NS_PER_S
from tel_ros.nodes import trial_recorder
from tel_ros.nodes.conversions import to_time
from tel_ros.nodes.diagnostics import Level
from tel_ros.nodes.trial_recorder import TrialRecorderNode
from tel_ros.recording import topics
from tel_ros.recording.bag_writer import UNFINISHED, TrialBagWriter
from tel_ros.recording.recover import recover
from tel_ros.recording.trial_bag import read_trial

JOINTS = ["shoulder", "elbow"]
PERIOD_NS = 2_000_000
START_NS = 10 * NS_PER_S
MakeRecorder = Callable[..., TrialRecorderNode]


@pytest.fixture
def recorder(monkeypatch: pytest.MonkeyPatch) -> Iterator[MakeRecorder]:
    """Return a function that makes the node with some parameters, e.g. ``recording.storage:=sqlite3``."""
    monkeypatch.setattr(trial_recorder, "HEARD_LATELY_S", 1e6)
    made = []

    def make(*parameters: str) -> TrialRecorderNode:
        arguments = [word for parameter in parameters for word in ("-p", parameter)]
        rclpy.init(args=["--ros-args", *arguments])
        made.append(TrialRecorderNode())
        tick(made[0], 0, trial=0)
        return made[0]

    yield make
    for node in made:
        node.destroy_node()
    rclpy.try_shutdown()


def answered(call: Coroutine[Any, Any, Any]) -> Any:
    """Return what a service answers that has nothing to wait for."""
    with pytest.raises(StopIteration) as done:
        call.send(None)
    return done.value.value


def start(node: TrialRecorderNode, bag: Path) -> Any:
    zeros = [0.0] * 4
    goal = TrialGoal(trial=1, joint_names=JOINTS, time_ns=[0, PERIOD_NS])
    goal.position_rad = goal.velocity_rad_s = goal.acceleration_rad_s2 = goal.equilibrium_rad = zeros
    request = StartRecording.Request(bag=str(bag), goal=goal, metadata_keys=["seed"], metadata_values=["7"])
    return answered(node._start(request, StartRecording.Response()))


def stop(node: TrialRecorderNode, ticks: int) -> Any:
    stamps = {"start_stamp": to_time(START_NS), "end_stamp": to_time(START_NS + (ticks - 1) * PERIOD_NS)}
    result = TrialResult(index=1, ticks=ticks, joint_names=JOINTS, **stamps)
    request = StopRecording.Request(result=result)
    return answered(node._stop_recording(request, StopRecording.Response()))


def state(node: TrialRecorderNode, k: int) -> None:
    message = JointState(name=JOINTS, position=[0.0, 0.0], velocity=[0.0, 0.0])
    message.header.stamp = to_time(START_NS + k * PERIOD_NS)
    node._record(topics.JOINT_STATES, serialize_message(message))


def tick(node: TrialRecorderNode, k: int, trial: int = 1, *, without: str = "") -> None:
    """Let a state, the command that answers it and the control state arrive."""
    stamp_ns = START_NS + k * PERIOD_NS
    if without != topics.JOINT_STATES:
        state(node, k)
    command = Float64MultiArray(data=[0.0, 0.0])
    command.layout.dim = [MultiArrayDimension(label=str(stamp_ns))]
    if without != topics.EFFORT_COMMANDS:
        node._record(topics.EFFORT_COMMANDS, serialize_message(command))
    control = ControlState(trial=trial, phase=ControlState.RUN, saturated=[False, False])
    for name in ("desired_position", "desired_velocity", "desired_acceleration", "equilibrium"):
        unit = {"desired_velocity": "_rad_s", "desired_acceleration": "_rad_s2"}.get(name, "_rad")
        setattr(control, name + unit, [0.0, 0.0])
    control.position_rad = control.velocity_rad_s = control.effort_nm = [0.0, 0.0]
    control.header.stamp = to_time(stamp_ns)
    node._record(topics.CONTROL_STATES, serialize_message(control))


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_a_trial_is_recorded_into_the_configured_storage(
    recorder: MakeRecorder, tmp_path: Path, storage: str
) -> None:
    node, bag = recorder(f"recording.storage:={storage}"), tmp_path / "trial_001"
    assert start(node, bag).success
    for k in range(5):
        tick(node, k)
    state(node, 5)
    stopped = stop(node, 5)
    assert stopped.success, stopped.message
    names = [name.removeprefix("/") for name in stopped.topics]
    counts = dict(zip(names, stopped.message_counts, strict=True))
    assert counts[topics.JOINT_STATES] == 6
    assert counts[topics.CONTROL_STATES] == counts[topics.EFFORT_COMMANDS] == 5
    information = yaml.safe_load((bag / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert information["storage_identifier"] == storage
    assert len(read_trial(bag).time_ns) == 5
    assert node._health().level == Level.OK


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_the_goal_is_on_the_disk_before_the_trial_begins(
    recorder: MakeRecorder, tmp_path: Path, storage: str
) -> None:
    """So whatever a crash leaves tells what the arm was asked to do, and by which configuration."""
    node, bag = recorder(f"recording.storage:={storage}"), tmp_path / "trial_001"
    assert start(node, bag).success
    found = recover(bag.parent / UNFINISHED / bag.name)
    assert found.counts[f"/{topics.TRIAL_GOAL}"] == 1
    with AnyReader([found.bag]) as reader:
        ((connection, time_ns, raw),) = reader.messages()
        assert time_ns == START_NS, "the newest joint state"
        assert reader.deserialize(raw, connection.msgtype).joint_names == JOINTS


@pytest.mark.parametrize(
    ("topic", "said"), [(topics.JOINT_STATES, topics.JOINT_STATES), (topics.EFFORT_COMMANDS, "commands")]
)
def test_messages_that_did_not_arrive_show_in_the_diagnostics(
    recorder: MakeRecorder, tmp_path: Path, topic: str, said: str
) -> None:
    node = recorder()
    assert start(node, tmp_path / "trial_001").success
    for k in range(9):
        tick(node, k, without=topic if k in (3, 4, 7) else "")
    state(node, 9)
    assert stop(node, 9).success
    health = node._health()
    assert health.level == Level.WARN and "did not arrive" in health.message
    assert health.values[f"missing {said}"] == 3
    assert start(node, tmp_path / "trial_002").success
    assert node._health().level == Level.OK, "a new trial is a new count"


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_a_full_disk_ends_the_recording_and_the_trial_hears_of_it(
    recorder: MakeRecorder, tmp_path: Path, storage: str
) -> None:
    node = recorder(f"recording.storage:={storage}", "recording.chunk_s:=0.004")
    bag = tmp_path / "trial_001"
    assert start(node, bag).success
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    (file,) = (f for f in (tmp_path / UNFINISHED / "trial_001").iterdir() if f.suffix in (".mcap", ".db3"))
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (file.stat().st_size, hard))
        for k in range(50):
            tick(node, k)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert node._health().level == Level.ERROR
    stopped = stop(node, 50)
    assert not stopped.success
    for said in (str(bag), "cannot be written", "MB are free there", "expected room on the disk"):
        assert said in stopped.message
    assert not bag.exists()


@pytest.fixture
def open_recorder(tmp_path: Path) -> Iterator[TrialRecorderNode]:
    """Return the node in this process, with an open bag; nothing spins it."""
    rclpy.init()
    node = TrialRecorderNode()
    node._writer = TrialBagWriter(tmp_path / "trial_001", {})
    node._stamps = {topic: [] for topic in topics.RECORDED_LIVE}
    yield node
    node.destroy_node()
    rclpy.try_shutdown()


def control_state(node: TrialRecorderNode, time_s: float, trial: int = 1) -> None:
    state = ControlState(trial=trial)
    state.header.stamp = to_time(round(time_s * NS_PER_S))
    node._record(topics.CONTROL_STATES, serialize_message(state))


@pytest.mark.parametrize("jump_s", [-5.0, 5.0])
def test_all_ticks_have_arrived_although_the_clock_has_jumped(
    open_recorder: TrialRecorderNode, jump_s: float
) -> None:
    stamps = [10.0, 10.1, 10.2, 10.3 + jump_s, 10.4 + jump_s, 10.5]
    for stamp in stamps:
        control_state(open_recorder, stamp)
    assert open_recorder._ticks[1] == len(stamps)


def test_neither_repetitions_nor_other_trials_count(open_recorder: TrialRecorderNode) -> None:
    for stamp, trial in ((9.9, 0), (10.0, 1), (10.0, 1), (10.1, 1), (10.2, 0), (10.3, 2)):
        control_state(open_recorder, stamp, trial)
    assert open_recorder._ticks[1] == 2
