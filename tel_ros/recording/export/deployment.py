"""A practised movement for ros2_control's joint_trajectory_controller: a folder that needs no tel_ros."""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from tel_ros.core.control.trajectory_points import TrajectoryPoints
from tel_ros.core.errors import ConfigError, InputFileError
from tel_ros.core.springs import Springs
from tel_ros.core.trial import TrialReport
from tel_ros.core.types import NS_PER_S, FloatArray
from tel_ros.recording import topics
from tel_ros.recording.bag_format import offered_qos, to_cdr
from tel_ros.recording.bag_writer import BagWriter
from tel_ros.recording.run_folder import is_run_folder, trial_bag, written_config
from tel_ros.recording.summary import read_rows
from tel_ros.recording.trial_bag import read_topic

CONTROLLER = "joint_trajectory_controller"
TRAJECTORY, GAINS, CLIENT, README = "trajectory.yaml", "controllers.yaml", "run_movement.py", "README.md"
LOST_SHARE = 0.1
"""How far û may be from the practised one where efforts are interpolated between points, as a share of the
tolerance of practice."""
GOAL_TIME_S = 1.0
_LONGEST_ARGUMENT = 131_000
"""Bytes of one argument of a command on Linux."""


@dataclass(frozen=True)
class Deployment:
    """A movement as it was practised. ``effort_limit_nm``: shape (n_joints,)."""

    joints: tuple[str, ...]
    rate_hz: float
    springs: Springs
    report: TrialReport
    tolerance_rad: float
    path_tolerance_rad: float
    effort_limit_nm: FloatArray
    effort_share: float | None
    """How much of the effort limits the movement was to use at most; None: its duration was given."""
    carried: str
    """What the arm carried, for people."""
    points: TrajectoryPoints

    @property
    def sag_rad(self) -> FloatArray:
        """How far the arm sags where it is held without efforts, at the start and at the end.

        There it is at rest, so the efforts are what holds it, as far as was learned. Shape (2, n_joints).
        """
        sag_rad: FloatArray = np.abs(self.points.effort_nm[[0, -1]]) / self.springs.stiffness_nm_per_rad
        return sag_rad

    def message(self) -> dict[str, Any]:
        """Return the trajectory_msgs/JointTrajectory, as plain values."""
        each = self.points
        arrays = each.position_rad, each.velocity_rad_s, each.acceleration_rad_s2, each.effort_nm
        keys = "positions", "velocities", "accelerations", "effort"
        points = []
        # Seven digits are finer than any encoder, and short enough for a command line.
        digits = [[[float(f"{v:.7g}") for v in row] for row in array.tolist()] for array in arrays]
        for time_ns, *rows in zip(each.time_ns.tolist(), *digits, strict=True):
            sec, nanosec = divmod(time_ns, NS_PER_S)
            values = dict(zip(keys, rows, strict=True))
            points.append({**values, "time_from_start": {"sec": sec, "nanosec": nanosec}})
        header = {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""}  # a stamp of 0: at once
        return {"header": header, "joint_names": list(self.joints), "points": points}


def practised(run: Path, rate_hz: float, trial: int | None = None, path: str = "") -> Deployment:
    """Return the fastest movement of a run that was practised within its tolerance, or that of one trial.

    ``rate_hz``: of the controller, whose set points come one period ahead. ``path``: which of several.

    Raises:
        InputFileError: there is no such run or trial, it goes on, or what it practised is not good enough.
        ConfigError: the arm takes positions, not efforts.
        BagError: the bag of the trial is missing or damaged.
    """
    if not is_run_folder(run):
        raise InputFileError(run, "is no practice run", "the folder of one")
    config, (trials, outcome, _) = written_config(run), read_rows(run)
    if (interface := config.arm.command_interface) != "effort":
        raise ConfigError("arm.command_interface", interface, "effort: points carry efforts", str(run))
    if outcome == "running":
        expected = "one that has ended (tel practice --resume)"
        raise InputFileError(run, "the run goes on, or was interrupted", expected)
    rows = [row for row in trials if trial in (None, row.index) and (not path or row.path == path)]
    if not rows:
        missing = "has no trial" if trial is None else f"has no trial {trial}"
        missing += f" of {path}" if path else ""
        raise InputFileError(run, missing, f"one of {len(trials)}")
    is_whole = config.practice.vary == ("speed",)
    tolerance_rad = config.practice.tolerance_rad
    good = [
        row
        for row in rows
        if row.completed and row.rms_error_rad <= tolerance_rad and (is_whole or row.alpha >= 1.0)
    ]
    if not good:
        last = rows[-1]
        rms = f"{1e3 * last.rms_error_rad:.2f} mrad RMS" if last.reached_run else "did not reach its movement"
        which = f"trial {last.index} of {path}" if path else f"trial {last.index}"
        found = f"{which} ({last.outcome.text}, {last.duration_s:.3g} s): {rms}"
        expected = f"a completed one within practice.tolerance_rad = {1e3 * tolerance_rad:g} mrad"
        raise InputFileError(run, found, f"{expected}; practise on")
    best = min(good, key=lambda row: (row.duration_s, row.rms_error_rad))
    ((_, goal),) = read_topic(trial_bag(run, best.index), topics.TRIAL_GOAL)
    order = [list(goal.joint_names).index(joint) for joint in config.arm.joints]

    def column(name: str) -> FloatArray:
        values: FloatArray = np.array(getattr(goal, name), dtype=np.float64)
        return values.reshape(-1, len(order))[:, order]

    springs = Springs.of(config.arm)
    if len(getattr(goal, "stiffness_nm_per_rad", ())):  # bags of earlier versions have no such field
        springs = Springs(column("stiffness_nm_per_rad")[0], column("damping_nms_per_rad")[0])
    position, velocity = column("position_rad"), column("velocity_rad_s")
    limit_nm = np.array(config.arm.effort_limit_nm)
    goal_ns = np.array(goal.time_ns, dtype=np.int64)
    points = TrajectoryPoints.of(
        springs,
        goal_ns,
        (position, velocity, column("acceleration_rad_s2")),
        column("equilibrium_rad"),
        limit_nm=limit_nm,
        periods_s=(1.0 / config.control.rate_hz, 1.0 / rate_hz),
        lost_rad=LOST_SHARE * tolerance_rad,
    )
    return Deployment(
        config.arm.joints,
        rate_hz,
        springs,
        best,
        tolerance_rad,
        config.control.path_tolerance_rad,
        limit_nm,
        best.effort_share,
        f"a payload of {config.sim.payload_kg:g} kg (simulated)"
        if config.run.arm == "sim"
        else "whatever the arm carried then",
        points,
    )


def deploy_all(movements: Mapping[Path, Deployment], out: Path) -> None:
    """Write a folder a movement; ``out``: the one that they are all in, or the only one itself.

    InputFileError: it exists or cannot be written, and nothing is left of it then.
    """
    if out.exists():
        raise InputFileError(out, "exists already", "a name that is free")
    try:
        for folder, movement in movements.items():
            deploy(movement, folder)
    except BaseException:
        shutil.rmtree(out, ignore_errors=True)
        raise


def deploy(movement: Deployment, out: Path) -> None:
    """Write the folder; InputFileError: it exists or cannot be written, and nothing is left of it then."""
    if out.exists():
        raise InputFileError(out, "exists already", "a name that is free")
    try:
        out.mkdir(parents=True)
        # JSON is YAML, and a shell hands it on as it is.
        text = json.dumps(movement.message(), allow_nan=False, separators=(",", ":")).replace(
            '{"positions"', '\n{"positions"'
        )
        (out / TRAJECTORY).write_text(text + "\n", encoding="utf-8")
        (out / GAINS).write_text(yaml.safe_dump(_gains(movement), sort_keys=False), encoding="utf-8")
        (out / CLIENT).write_text(_CLIENT, encoding="utf-8")
        (out / README).write_text(_readme(movement, len(text)), encoding="utf-8")
        with BagWriter(out / "bag", {"movement": "a practised movement"}) as bag:
            topic = f"/{CONTROLLER}/joint_trajectory"
            bag.add_topic(topic, topics.JOINT_TRAJECTORY, [offered_qos(topic)])
            bag.write(topic, 0, to_cdr(topics.JOINT_TRAJECTORY, movement.message()))
    except BaseException as error:
        shutil.rmtree(out, ignore_errors=True)
        if isinstance(error, OSError):
            expected = "a folder that can be written"
            raise InputFileError(out, f"cannot be written ({error.strerror})", expected) from error
        raise


def _goal_tolerance_rad(movement: Deployment) -> float:
    """Return how far a joint may be off at the end: three times the largest error that was practised."""
    return max(3.0 * movement.report.max_error_rad, movement.tolerance_rad)


def _gains(movement: Deployment) -> dict[str, Any]:
    stiffness, damping = movement.springs.stiffness_nm_per_rad, movement.springs.damping_nms_per_rad
    gains = {
        joint: {"p": float(k), "i": 0.0, "d": float(b), "i_clamp": 0.0, "ff_velocity_scale": 0.0}
        for joint, k, b in zip(movement.joints, stiffness, damping, strict=True)
    }
    tolerances = {"trajectory": movement.path_tolerance_rad, "goal": _goal_tolerance_rad(movement)}
    return {
        CONTROLLER: {
            "ros__parameters": {
                "joints": list(movement.joints),
                "command_interfaces": ["effort"],
                "state_interfaces": ["position", "velocity"],
                "gains": gains,
                "constraints": {
                    "goal_time": GOAL_TIME_S,
                    **{joint: dict(tolerances) for joint in movement.joints},
                },
            }
        }
    }


def _readme(movement: Deployment, size: int) -> str:
    report, n = movement.report, len(movement.points.time_ns)
    start = ", ".join(
        f"{joint} {q:.4f}" for joint, q in zip(movement.joints, movement.points.position_rad[0], strict=True)
    )
    rows = zip(
        movement.joints,
        report.rms_error_per_joint_rad,
        report.max_effort_nm,
        movement.effort_limit_nm,
        strict=True,
    )
    table = "\n".join(
        f"| {joint} | {1e3 * rms:.2f} | {effort:.3g} | {limit:g} |" for joint, rms, effort, limit in rows
    )
    action = f"/{CONTROLLER}/follow_joint_trajectory"
    line = f"ros2 action send_goal {action} control_msgs/action/FollowJointTrajectory \\\n"
    line += f'        "{{trajectory: $(cat {TRAJECTORY})}}"'
    if size > _LONGEST_ARGUMENT:
        line = f"python3 {CLIENT}    # {size / 1e3:.0f} kB are too many for a command line"
    ratio = report.saturated_ratio
    warning = f" The safety layer changed the effort in {ratio:.1%} of its states." if ratio > 0.0 else ""
    rms_mrad, tolerance_mrad = 1e3 * report.rms_error_rad, 1e3 * movement.tolerance_rad
    most_mrad, goal_rad = 1e3 * report.max_error_rad, _goal_tolerance_rad(movement)
    shares = report.max_effort_nm / movement.effort_limit_nm
    most_used = f"{shares.max():.0%} of its limit ({movement.joints[int(shares.argmax())]})"
    if movement.effort_share is not None:
        most_used += f"; it was to use {movement.effort_share:.0%} at most"
    sag_mrad, sagging = 1e3 * movement.sag_rad.max(axis=1), movement.sag_rad.argmax(axis=1)
    sag = " and ".join(
        f"{mrad:.1f} mrad ({movement.joints[int(joint)]}) at the {where}"
        for mrad, joint, where in zip(sag_mrad, sagging, ("start", "end"), strict=True)
    )
    return f"""# A practised movement of {report.duration_s:.3f} s

Trial {report.index} of a practice run, {n} points. Expected, with {movement.carried}:
{rms_mrad:.2f} mrad RMS (tolerance {tolerance_mrad:g}), at most {most_mrad:.1f} mrad.{warning}
The largest effort is {most_used}.

| joint | RMS error, mrad | largest effort, N·m | limit, N·m |
| --- | --- | --- | --- |
{table}

1. Load `{GAINS}` into a `{CONTROLLER}` with an effort command interface, at
   {movement.rate_hz:g} Hz. Gains and rate are part of the movement: with others it is not the practised one.
2. Bring the arm to rest at the start: {start} rad.
3. Run it, in this folder:

        {line}

   or `python3 {CLIENT}`, which also says how it ended; or play `bag`, which publishes it on
   `/{CONTROLLER}/joint_trajectory` at once, without result.

The controller aborts if a joint is more than {movement.path_tolerance_rad:g} rad off,
or {goal_rad:.3g} rad at the end. After an abort or a cancellation it holds with p and d alone,
**without these efforts**: an arm that does not compensate its own weight sags by its torque over p, or falls.
By the efforts that were learned it would sag by {sag}; elsewhere it may be more.
"""


_CLIENT = f'''"""Run the movement in {TRAJECTORY} and say how it ended.

Needs rclpy, control_msgs and rosidl_runtime_py.
"""

import pathlib
import sys

import rclpy
import yaml
from control_msgs.action import FollowJointTrajectory
from rclpy.action import ActionClient
from rclpy.signals import SignalHandlerOptions
from rosidl_runtime_py import set_message_fields

goal = FollowJointTrajectory.Goal()
file = pathlib.Path(__file__).parent / "{TRAJECTORY}"
set_message_fields(goal.trajectory, yaml.safe_load(file.read_text()))
rclpy.init(signal_handler_options=SignalHandlerOptions.NO)  # after Ctrl-C there is a goal to cancel
node = rclpy.create_node("practised_movement")
client = ActionClient(node, FollowJointTrajectory, "{CONTROLLER}/follow_joint_trajectory")
if not client.wait_for_server(timeout_sec=5.0):
    sys.exit("there is no {CONTROLLER}")
sent = client.send_goal_async(goal)
rclpy.spin_until_future_complete(node, sent)
if not sent.result().accepted:
    sys.exit("the goal was rejected; the controller's log says why")
done = sent.result().get_result_async()
try:
    rclpy.spin_until_future_complete(node, done)
except KeyboardInterrupt:
    rclpy.spin_until_future_complete(node, sent.result().cancel_goal_async(), timeout_sec=1.0)
    sys.exit("interrupted: the controller was asked to stop and hold")
result = done.result().result
sys.exit(f"error {{result.error_code}}: {{result.error_string}}" if result.error_code else None)
'''
