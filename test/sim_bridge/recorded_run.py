"""A practice run with bags, networks and summary, as the graph leaves it in lockstep, made without ROS."""

from __future__ import annotations

import sys
from array import array
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "recording"))

from synthetic_trial import message, stamp  # noqa: E402

from sim_bridge.arm import ArmReading  # noqa: E402
from tel_lab.offline import OfflineArm  # noqa: E402
from tel_ros.core.config import Config  # noqa: E402
from tel_ros.core.practice.session import CommandedTrial, PracticeSession  # noqa: E402
from tel_ros.core.practice.strategies import make_strategy  # noqa: E402
from tel_ros.core.practice.strategy import PlannedTrial  # noqa: E402
from tel_ros.core.springs import Springs  # noqa: E402
from tel_ros.core.trial import Trial, TrialGoal, TrialReport  # noqa: E402
from tel_ros.recording import topics  # noqa: E402
from tel_ros.recording.bag_format import typestore  # noqa: E402
from tel_ros.recording.bag_writer import TrialBagWriter  # noqa: E402
from tel_ros.recording.config_file import load_config  # noqa: E402
from tel_ros.recording.network_file import (  # noqa: E402
    load_network,
    new_network,  # noqa: E402
    revision,
    save_network,
)
from tel_ros.recording.resumption import RecordedNetwork  # noqa: E402
from tel_ros.recording.run_folder import (  # noqa: E402
    CONFIG_FILE,
    create_run_folder,
    network_after,
    publish_network,
    trial_bag,
)
from tel_ros.recording.summary import RunSummary, TrialRow  # noqa: E402
from tel_ros.recording.trial_bag import trial_metadata  # noqa: E402
from tel_ros.recording.trial_result import result_fields  # noqa: E402
from tel_ros.recording.waypoint_file import load_known_path, load_path  # noqa: E402


@dataclass
class RecordingArm:
    """An arm whose trials are read back from the bags that it writes."""

    arm: OfflineArm
    folder: Path
    config: Config
    written: Config
    network: RecordedNetwork

    def execute(self, commanded: CommandedTrial) -> tuple[TrialReport, Path]:
        """Execute and record a trial."""
        trial = self.arm.run_trial(commanded.goal)
        bag = trial_bag(self.folder, commanded.plan.index)
        before = load_network(network_after(self.folder, self.network.after))
        metadata = trial_metadata(commanded.plan, self.config, self.written, revision(before))
        with TrialBagWriter(bag, metadata, self.config.recording) as writer:
            end = self.arm.plant.reading()
            for topic, time_ns, data in _messages(commanded.goal, trial, self.config, end):
                writer.write(topic, time_ns, data)
        return trial.report, bag


def record_run(folder: Path, config: Config) -> Config:
    """Practise, and write the folder of the run; return its configuration as read back from there."""
    written = create_run_folder(folder, config)
    config = load_config(folder / CONFIG_FILE)
    path, known = load_path(config.path, config.arm), load_known_path(config.path, config.arm)
    save_network(new_network(config), network_after(folder, 0))
    summary, network = RunSummary(folder, written), RecordedNetwork(folder, config)
    with OfflineArm(config) as plant:
        arm = RecordingArm(plant, folder, config, written, network)
        session = PracticeSession(config, path, known, make_strategy(config), arm, network)
        while isinstance(plan := session.next(), PlannedTrial):
            done = session.run_trial(plan)
            summary.add(TrialRow.of(done, done.trial.name, 1.0))
            if done.training is not None:
                publish_network(folder, plan.index)
    summary.end(plan.outcome, plan.message)
    return config


def _messages(
    goal: TrialGoal, trial: Trial, config: Config, end: ArmReading
) -> Iterator[tuple[str, int, bytes]]:
    joints = config.arm.joints
    interface = config.arm.command_interface
    commands = trial.effort_nm if interface == "effort" else trial.equilibrium_rad
    for k, time_ns in enumerate(trial.time_ns.tolist()):
        yield _joint_state(joints, time_ns, trial.position_rad[k], trial.velocity_rad_s[k])
        yield _serialised(
            topics.COMMANDS[interface],
            "std_msgs/msg/Float64MultiArray",
            time_ns,
            layout=typestore().types["std_msgs/msg/MultiArrayLayout"](dim=[], data_offset=0),
            data=commands[k],
        )
        position, velocity, acceleration = np.split(trial.desired[k], 3)
        yield _serialised(
            topics.CONTROL_STATES,
            "tel_interfaces/msg/ControlState",
            time_ns,
            header=_header(time_ns),
            trial=goal.index,
            phase=int(trial.phase[k]),
            time_from_start_s=0.0,
            desired_position_rad=position,
            desired_velocity_rad_s=velocity,
            desired_acceleration_rad_s2=acceleration,
            equilibrium_rad=trial.equilibrium_rad[k],
            position_rad=trial.position_rad[k],
            velocity_rad_s=trial.velocity_rad_s[k],
            effort_nm=trial.effort_nm[k],
            saturated=trial.saturated[k],
        )
    yield _joint_state(joints, end.time_ns, np.array(end.position_rad), np.array(end.velocity_rad_s))
    yield _goal(goal, trial.report, joints, goal.springs or Springs.of(config.arm))
    yield _result(trial.report, joints)


def _goal(
    goal: TrialGoal, report: TrialReport, joints: tuple[str, ...], springs: Springs
) -> tuple[str, int, bytes]:
    return _serialised(
        topics.TRIAL_GOAL,
        "tel_interfaces/msg/TrialGoal",
        report.run_ns or report.start_ns,
        trial=goal.index,
        alpha=goal.alpha,
        joint_names=list(joints),
        time_ns=goal.desired.time_ns,
        position_rad=goal.desired.position_rad.ravel(),
        velocity_rad_s=goal.desired.velocity_rad_s.ravel(),
        acceleration_rad_s2=goal.desired.acceleration_rad_s2.ravel(),
        equilibrium_rad=goal.equilibrium_rad.ravel(),
        stiffness_nm_per_rad=springs.stiffness_nm_per_rad,
        damping_nms_per_rad=springs.damping_nms_per_rad,
        std_rad=np.zeros(0),
    )


def _result(report: TrialReport, joints: tuple[str, ...]) -> tuple[str, int, bytes]:
    fields = result_fields(report, stamp)
    arrays = {key: np.array(value) for key, value in fields.items() if isinstance(value, array)}
    kind = "tel_interfaces/msg/TrialResult"
    return _serialised(
        topics.TRIAL_RESULT, kind, report.end_ns, joint_names=list(joints), **{**fields, **arrays}
    )


def _joint_state(
    joints: tuple[str, ...], time_ns: int, position_rad: np.ndarray, velocity_rad_s: np.ndarray
) -> tuple[str, int, bytes]:
    return _serialised(
        topics.JOINT_STATES,
        "sensor_msgs/msg/JointState",
        time_ns,
        header=_header(time_ns),
        name=list(joints),
        position=position_rad,
        velocity=velocity_rad_s,
        effort=np.zeros(len(joints)),
    )


def _serialised(topic: str, kind: str, at_ns: int, /, **fields: Any) -> tuple[str, int, bytes]:
    return topic, at_ns, message(kind, **fields)


def _header(time_ns: int) -> Any:
    return typestore().types["std_msgs/msg/Header"](stamp=stamp(time_ns), frame_id="")
