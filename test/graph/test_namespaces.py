"""Names: two arms side by side in two namespaces, a description on a topic, a renamed controller."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import rclpy
from graph_harness import Graph
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rclpy.context import Context
from rclpy.node import Node
from rosbags.highlevel import AnyReader
from std_msgs.msg import Bool, String
from tel_interfaces.msg import ControlState
from tel_interfaces.srv import StartRecording
from tel_process import HANG_S, PAPER, QUICK, StartTel, summary_of

from tel_ros.core.errors import ConfigError, TelError
from tel_ros.nodes import qos, robot_description
from tel_ros.recording import topics
from tel_ros.recording.config_file import load_config
from tel_ros.recording.provenance import stored_urdf
from tel_ros.recording.run_folder import trial_bags
from tel_ros.recording.trial_bag import read_topic, read_trial

NO_FILE = "arm.urdf=''"


@pytest.fixture
def described(domain: int) -> Iterator[str]:
    """Publish the description of the paper's arm in a namespace, as robot_state_publisher does."""
    text = Path(load_config(PAPER).arm.urdf).read_text()
    context = Context()
    rclpy.init(context=context, domain_id=domain)
    publisher = Node("somebody", namespace="left", context=context)
    publisher.create_publisher(String, topics.ROBOT_DESCRIPTION, qos.LATCHED).publish(String(data=text))
    yield text
    publisher.destroy_node()
    context.try_shutdown()


def test_two_arms_practise_side_by_side_one_of_them_described_by_its_topic(
    described: str, tel: StartTel
) -> None:
    arms = {"left": NO_FILE, "lab/right": "seed=1"}
    quick = (*QUICK, "practice.trials=1")
    runs = {side: tel(*quick, its, name=side, more=("--namespace", side)) for side, its in arms.items()}
    for side, run in runs.items():
        code, out, err = run.finish()
        assert code == 0, err
        assert summary_of(out)["outcome"] == "completed"
        (bag,) = trial_bags(run.folder)
        with AnyReader([bag]) as reader:
            names = {connection.topic for connection in reader.connections}
        assert names >= {f"/{side}/{topic}" for topic in (topics.JOINT_STATES, topics.CONTROL_STATES)}
        assert all(name.startswith(f"/{side}/") for name in names)
        trial = read_trial(bag)
        assert trial.report.index == 1
        assert len(read_topic(bag, topics.JOINT_STATES)) > 100
        assert stored_urdf(bag, trial.metadata).decode() == described  # the same arm
    assert (runs["left"].folder / "robot_description.urdf").read_text() == described


def test_a_node_waits_for_the_description_under_its_own_names(described: str) -> None:
    rclpy.init()
    node = Node("controller", namespace="left")
    try:
        assert robot_description.description_for(node).read_text() == described
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


def test_without_a_description_one_line_says_what_is_missing(
    domain: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(robot_description, "TIMEOUT_S", 0.3)
    with pytest.raises(TelError, match="no robot description on /right/robot_description within 0.3 s"):
        robot_description.description_in("/right")
    with pytest.raises(ConfigError, match=r"arm\.urdf is ''; expected a URDF file"):
        load_config(PAPER, [NO_FILE])


def test_a_renamed_controller_takes_its_own_names_along(graph: Callable[..., Graph], tmp_path: Path) -> None:
    """Whoever talks to it is told by remapping rules, as for any other node."""
    running = graph(["sim_bridge"])
    renamed = ["-r", "__node:=left_controller"]
    told = ["-r", f"{topics.CONTROL_STATES}:=left_controller/state"]
    config = ["-p", f"config:={running.folder / 'run.yaml'}"]
    processes = [
        subprocess.Popen([sys.executable, "-m", f"tel_ros.nodes.{name}", "--ros-args", *config, *rules])
        for name, rules in (("ep_controller", renamed), ("trial_recorder", told))
    ]
    try:
        for transition in (Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_ACTIVATE):
            request = ChangeState.Request(transition=Transition(id=transition))
            assert running.call(ChangeState, "left_controller/change_state", request).success
        ready: list[Bool] = []
        running.node.create_subscription(Bool, "left_controller/ready", ready.append, qos.LATCHED)
        states = running.listen(ControlState, "left_controller/state")
        running.spin_until(lambda: bool(ready) and ready[-1].data and bool(states), "its topics")
        start = StartRecording.Request(bag=str(tmp_path / "bag"), goal=running.goal())
        assert running.call(StartRecording, topics.START_RECORDING, start).success
    finally:
        for process in processes:
            process.terminate()
        for process in processes:
            process.wait(HANG_S)
