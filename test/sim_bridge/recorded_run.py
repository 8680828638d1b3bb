"""A practice run with bags, networks and summary, as the graph leaves it in lockstep, made without ROS."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "recording"))

from synthetic_trial import message, stamp  # noqa: E402

from sim_bridge.arm import ArmReading  # noqa: E402
from tel_lab.offline import OfflinePractice, PractisedTrial  # noqa: E402
from tel_ros.core.config import Config  # noqa: E402
from tel_ros.core.practice.decisions import PlannedTrial  # noqa: E402
from tel_ros.core.practice.lock_up import LockUpMonitor  # noqa: E402
from tel_ros.core.practice.movement_path import command, desired_trajectory  # noqa: E402
from tel_ros.core.practice.strategy import make_strategy  # noqa: E402
from tel_ros.core.springs import Springs  # noqa: E402
from tel_ros.recording import topics  # noqa: E402
from tel_ros.recording.bag_format import typestore  # noqa: E402
from tel_ros.recording.bag_writer import TrialBagWriter  # noqa: E402
from tel_ros.recording.config_file import load_config  # noqa: E402
from tel_ros.recording.earlier_trials import NetworkForecast  # noqa: E402
from tel_ros.recording.network_file import load_network, revision, save_network  # noqa: E402
from tel_ros.recording.new_network import new_network  # noqa: E402
from tel_ros.recording.run_folder import (  # noqa: E402
    CONFIG_FILE,
    NETWORK_FILE,
    create_run_folder,
    network_after,
    trial_bag,
)
from tel_ros.recording.summary import RunSummary, TrialRow  # noqa: E402
from tel_ros.recording.trial_metadata import trial_metadata  # noqa: E402
from tel_ros.recording.trial_timing import timing_fields  # noqa: E402
from tel_ros.recording.waypoint_file import load_known_path, load_path  # noqa: E402


def record_run(folder: Path, config: Config) -> Config:
    """Practise, and write the folder of the run; return its configuration as read back from there."""
    written = create_run_folder(folder, config)
    config = load_config(folder / CONFIG_FILE)
    path, known = load_path(config.path, config.arm), load_known_path(config.path, config.arm)
    save_network(new_network(config), network_after(folder, 0))
    strategy, last = make_strategy(config), None
    forecast = NetworkForecast(folder, config)
    lock_up = LockUpMonitor(config.practice.tolerance_rad)
    summary = RunSummary(folder, written)
    with OfflinePractice(config, path, new_network(config), known) as practice:
        while isinstance(plan := strategy.next(last, forecast), PlannedTrial):
            if plan.go_back_to is not None:
                practice.learner = load_network(network_after(folder, plan.go_back_to))
            before = practice.learner
            done = practice.run_trial(plan)
            last = done.trial.report
            desired = desired_trajectory(path, known, plan.movement, config.control.rate_hz)
            asked = command(config.arm, plan.movement, desired, desired.position_rad)
            springs = asked.springs or Springs.of(config.arm)
            bag = trial_bag(folder, plan.index)
            metadata = trial_metadata(plan, config, written, revision(before))
            with TrialBagWriter(bag, metadata, config.recording) as writer:
                for topic, time_ns, data in _messages(done, config, springs, practice.arm.plant.reading()):
                    writer.write(topic, time_ns, data)
            summary.add(_row(done, bag, lock_up))
            if done.training is not None:
                save_network(done.learner, network_after(folder, plan.index))
                save_network(done.learner, folder / NETWORK_FILE)
                forecast.after = plan.index
    summary.end(plan.outcome, plan.message)
    return config


def _row(done: PractisedTrial, bag: Path, lock_up: LockUpMonitor) -> TrialRow:
    row = TrialRow(plan=done.plan, report=done.trial.report, bag=bag.name, wall_s=1.0)
    if done.training is not None:
        row.training_rms_before_rad = done.training.rms_before_rad
        row.training_rms_after_rad = done.training.rms_after_rad
        row.rms_command_change_rad = done.training.rms_command_change_rad
        row.grown = list(done.training.grown)
        row.warning = lock_up.after_trial(
            done.plan.alpha,
            row.report.rms_error_rad,
            row.training_rms_before_rad,
            row.training_rms_after_rad,
        )
    return row


def _messages(
    done: PractisedTrial, config: Config, springs: Springs, end: ArmReading
) -> Iterator[tuple[str, int, bytes]]:
    trial, joints = done.trial, config.arm.joints
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
            trial=done.plan.index,
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
    yield _goal(done, joints, springs)
    yield _result(done, joints)


def _goal(done: PractisedTrial, joints: tuple[str, ...], springs: Springs) -> tuple[str, int, bytes]:
    goal = done.goal
    return _serialised(
        topics.TRIAL_GOAL,
        "tel_interfaces/msg/TrialGoal",
        done.trial.report.run_ns or done.trial.report.start_ns,
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


def _result(done: PractisedTrial, joints: tuple[str, ...]) -> tuple[str, int, bytes]:
    report = done.trial.report
    return _serialised(
        topics.TRIAL_RESULT,
        "tel_interfaces/msg/TrialResult",
        report.end_ns,
        index=report.index,
        outcome=int(report.outcome),
        message=report.message,
        alpha=report.alpha,
        duration_s=report.duration_s,
        start_stamp=stamp(report.start_ns),
        run_stamp=stamp(report.run_ns),
        end_stamp=stamp(report.end_ns),
        ticks=report.ticks,
        joint_names=list(joints),
        rms_error_rad=report.rms_error_rad,
        rms_error_per_joint_rad=report.rms_error_per_joint_rad,
        max_error_rad=report.max_error_rad,
        max_effort_nm=report.max_effort_nm,
        saturated_ratio=report.saturated_ratio,
        **timing_fields(None),
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
