"""Namespaces and renamed nodes: two arms side by side, and a controller under another name."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

from graph_harness import Graph
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rosbags.highlevel import AnyReader
from std_msgs.msg import Bool
from tel_interfaces.msg import ControlState
from tel_interfaces.srv import StartRecording
from tel_process import HANG_S, QUICK, TelProcess, summary_of

from tel_ros.nodes import qos
from tel_ros.recording import topics
from tel_ros.recording.run_folder import trial_bags
from tel_ros.recording.trial_bag import read_topic, read_trial


def test_two_arms_practise_side_by_side_in_two_namespaces(tel: Callable[..., TelProcess]) -> None:
    quick = (*QUICK, "practice.trials=2")
    runs = {
        side: tel(*quick, f"seed={seed}", name=side, more=("--namespace", side))
        for seed, side in enumerate(("left", "lab/right"))
    }
    finished = {side: run.finish() for side, run in runs.items()}
    for side, (code, out, err) in finished.items():
        assert code == 0, err
        assert summary_of(out)["outcome"] == "completed"
        for bag in trial_bags(runs[side].folder):
            with AnyReader([bag]) as reader:
                names = {connection.topic for connection in reader.connections}
            assert names >= {f"/{side}/{topic}" for topic in (topics.JOINT_STATES, topics.CONTROL_STATES)}
            assert all(name.startswith(f"/{side}/") for name in names)
            assert read_trial(bag).report.index == int(bag.name[-3:])
            assert len(read_topic(bag, topics.JOINT_STATES)) > 100


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
