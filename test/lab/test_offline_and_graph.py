"""Trials without ROS and trials of the ROS graph are the same, message by message."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.highlevel import AnyReader

from sim_bridge.arm import ArmReading
from tel_lab.offline import OfflineArm
from tel_ros.core.learning.signals import learning_record
from tel_ros.core.trajectories.trajectory import DesiredTrajectory
from tel_ros.core.trial import Trial, TrialGoal
from tel_ros.core.types import NS_PER_S
from tel_ros.recording import topics
from tel_ros.recording.config_file import load_config
from tel_ros.recording.trial_bag import read_trial

SAMPLE_RUN = Path(__file__).parents[2] / "bags" / "sample_run"


def recorded(bag: Path, topic: str) -> list[Any]:
    with AnyReader([bag]) as reader:
        connections = [c for c in reader.connections if topics.is_named(c.topic, topic)]
        return [reader.deserialize(raw, c.msgtype) for c, _, raw in reader.messages(connections)]


def recorded_goal(bag: Path) -> TrialGoal:
    (message,) = recorded(bag, topics.TRIAL_GOAL)
    rows = [
        np.array(getattr(message, name)).reshape(len(message.time_ns), -1)
        for name in ("position_rad", "velocity_rad_s", "acceleration_rad_s2", "equilibrium_rad")
    ]
    return TrialGoal(
        message.trial, message.alpha, DesiredTrajectory(np.array(message.time_ns), *rows[:3]), rows[3]
    )


def test_the_ros_graph_and_the_same_trials_offline_agree_message_by_message() -> None:
    """The bags were recorded by the whole graph in lockstep; trial 2 begins where trial 1 has ended."""
    with OfflineArm(load_config(SAMPLE_RUN / "run.yaml")) as arm:
        for bag in (SAMPLE_RUN / "trial_001", SAMPLE_RUN / "trial_002"):
            assert_recorded(bag, arm.run_trial(recorded_goal(bag)), arm.plant.reading())


def assert_recorded(bag: Path, trial: Trial, end: ArmReading) -> None:
    from_bag = read_trial(bag)
    for ours, theirs in ((trial, from_bag), (learning_record(trial), learning_record(from_bag))):
        for field in fields(ours):
            if field.name != "report":
                np.testing.assert_array_equal(getattr(theirs, field.name), getattr(ours, field.name))
    (result,) = recorded(bag, topics.TRIAL_RESULT)
    for name in ("index", "outcome", "message", "ticks", "rms_error_rad", "max_error_rad"):
        assert getattr(result, name) == getattr(trial.report, name)

    commands = recorded(bag, topics.EFFORT_COMMANDS)
    np.testing.assert_array_equal([command.data for command in commands], trial.effort_nm)

    # The last state is the one that the last command has led to. The very first one of the run was there
    # before the recorder listened.
    states = recorded(bag, topics.JOINT_STATES)
    assert len(states) >= len(trial.time_ns)
    rows = slice(-len(states), None)
    stamps_ns = [state.header.stamp.sec * NS_PER_S + state.header.stamp.nanosec for state in states]
    assert stamps_ns == [*trial.time_ns, end.time_ns][rows]
    for name, offline, last in (
        ("position", trial.position_rad, end.position_rad),
        ("velocity", trial.velocity_rad_s, end.velocity_rad_s),
    ):
        np.testing.assert_array_equal([getattr(s, name) for s in states], np.vstack([offline, last])[rows])
    acted_nm = [state.effort for state in states[-len(trial.time_ns) :]]
    np.testing.assert_array_equal(acted_nm, trial.effort_nm)
