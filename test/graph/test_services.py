"""The network and the recorder as services: what they refuse, and that nothing is lost by it."""

from __future__ import annotations

import signal
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from graph_harness import Graph
from rclpy.publisher import Publisher
from sensor_msgs.msg import JointState
from tel_interfaces.msg import ControlState
from tel_interfaces.srv import (
    LoadNetwork,
    PredictEquilibrium,
    SaveNetwork,
    StartRecording,
    TrainOnTrials,
)
from tel_process import ROOT, wait_until

from tel_ros.nodes.conversions import desired_message
from tel_ros.recording import topics
from tel_ros.recording.network_file import load_network, save_network

StartGraph = Callable[..., Graph]

SAMPLE_BAG = ROOT / "bags" / "sample_run" / "trial_001"


def predict(running: Graph, duration_s: float = 5.0) -> PredictEquilibrium.Response:
    desired = desired_message(running.config.arm.joints, running.desired(duration_s))
    return running.call(PredictEquilibrium, topics.PREDICT, PredictEquilibrium.Request(desired=desired))


def keep_saying(running: Graph) -> Publisher:
    """Publish joint states and control states as an arm and a controller at rest do; return the former."""
    states = running.node.create_publisher(JointState, topics.JOINT_STATES, 10)
    control = running.node.create_publisher(ControlState, topics.CONTROL_STATES, 10)
    said = [(states, JointState()), (control, ControlState())]
    running.node.create_timer(0.05, lambda: [publisher.publish(message) for publisher, message in said])
    return states


def test_the_network_learns_from_a_bag_and_survives_everything_that_is_wrong(
    graph: StartGraph, tmp_path: Path
) -> None:
    running = graph(["inverse_dynamics"])
    untrained = predict(running)
    desired = running.desired(5.0).position_rad
    assert [list(p.positions) for p in untrained.equilibrium.points] == desired.tolist()
    assert len(untrained.std_rad) == desired.size
    assert np.all(np.isinf(untrained.std_rad))

    trained = running.call(TrainOnTrials, topics.TRAIN, TrainOnTrials.Request(bags=[str(SAMPLE_BAG)]))
    assert trained.success, trained.message
    assert trained.training_rms_after_rad < 0.5 * trained.training_rms_before_rad
    assert list(trained.subtrees) == [1, 1]
    assert np.all(np.isfinite(predict(running).std_rad))
    assert predict(running).revision == trained.revision != untrained.revision

    file = tmp_path / "network.npz"
    saved = running.call(SaveNetwork, topics.SAVE, SaveNetwork.Request(path=str(file)))
    assert saved.success and saved.revision == trained.revision
    torque = load_network(file)
    torque.context = replace(torque.context, predicts="torque")
    save_network(torque, tmp_path / "torque.npz")
    half = tmp_path / "half.npz"
    half.write_bytes(file.read_bytes()[:2000])
    unclosed = tmp_path / "unclosed"
    unclosed.mkdir()
    (unclosed / "unclosed.mcap").write_bytes((SAMPLE_BAG / "trial_001.mcap").read_bytes()[:5000])
    for kind, name, request, reason in [
        (
            LoadNetwork,
            topics.LOAD,
            LoadNetwork.Request(path=str(half)),
            "expected a network saved by tel_ros",
        ),
        (LoadNetwork, topics.LOAD, LoadNetwork.Request(path="/nowhere.npz"), "there is no such file"),
        (
            LoadNetwork,
            topics.LOAD,
            LoadNetwork.Request(path=str(tmp_path / "torque.npz")),
            "this one predicts torque",
        ),
        (SaveNetwork, topics.SAVE, SaveNetwork.Request(path="/proc/network.npz"), "cannot be written"),
        (TrainOnTrials, topics.TRAIN, TrainOnTrials.Request(bags=[str(unclosed)]), "it was never closed"),
        (TrainOnTrials, topics.TRAIN, TrainOnTrials.Request(bags=[]), "expected at least one bag"),
        (
            TrainOnTrials,
            topics.TRAIN,
            TrainOnTrials.Request(bags=[str(SAMPLE_BAG)], training="ideal"),
            "training is 'ideal'; expected 'actual' or 'desired'",
        ),
    ]:
        response = running.call(kind, name, request)
        assert not response.success
        assert reason in response.message
        assert predict(running).revision == trained.revision  # the network is as it was

    running.call(TrainOnTrials, topics.TRAIN, TrainOnTrials.Request(bags=[str(SAMPLE_BAG)]))
    loaded = running.call(LoadNetwork, topics.LOAD, LoadNetwork.Request(path=str(file)))
    assert loaded.success and predict(running).revision == saved.revision


def test_a_recorder_overwrites_no_bag_and_leaves_none_under_the_trials_name_when_it_dies(
    graph: StartGraph, tmp_path: Path
) -> None:
    running = graph(["trial_recorder"])
    bag = tmp_path / "bags" / "trial_001"
    refused = running.call(StartRecording, topics.START_RECORDING, StartRecording.Request(bag=str(bag)))
    assert not refused.success
    assert "nothing is heard on /joint_states, /ep_controller/state" in refused.message

    states = keep_saying(running)
    there = tmp_path / "trial_001"
    there.mkdir()
    (there / "precious").write_text("data")
    refused = running.call(StartRecording, topics.START_RECORDING, StartRecording.Request(bag=str(there)))
    assert not refused.success and "bags are never overwritten" in refused.message
    assert (there / "precious").read_text() == "data"
    started = running.call(StartRecording, topics.START_RECORDING, StartRecording.Request(bag=str(bag)))
    assert started.success, started.message
    twice = running.call(StartRecording, topics.START_RECORDING, StartRecording.Request(bag=str(bag) + "x"))
    assert not twice.success and "one recording at a time" in twice.message
    for k in range(200):
        message = JointState(name=["shoulder", "elbow"], position=[0.0, 0.0], velocity=[0.0, 0.0])
        message.header.stamp.nanosec = k
        states.publish(message)
    running.signal("trial_recorder", signal.SIGKILL)
    unfinished = bag.parent / ".unfinished" / bag.name
    wait_until(unfinished.is_dir, "the unfinished bag")
    assert not bag.exists()
    assert not (unfinished / "metadata.yaml").exists()
