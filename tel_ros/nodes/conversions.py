"""Between ROS messages and the records of the core."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Sequence
from dataclasses import fields
from typing import Any

import numpy as np
from builtin_interfaces.msg import Duration, Time
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from tel_interfaces.msg import ControlState, TrialResult
from tel_interfaces.msg import TrialGoal as TrialGoalMessage
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from tel_ros.core.arm_state import ArmState
from tel_ros.core.errors import StateError, TrajectoryError, counted
from tel_ros.core.springs import Springs
from tel_ros.core.trajectories.trajectory import DesiredTrajectory
from tel_ros.core.trial import TrialGoal, TrialReport
from tel_ros.core.types import NS_PER_S, FloatArray, IntArray
from tel_ros.recording.cdr import (
    CommandLayout,
    CommandNumbers,
    JointStateLayout,
    JointStateNumbers,
    message_reader,
    time_ns,
)
from tel_ros.recording.trial_result import result_fields

_DESIRED = {
    "position_rad": "positions",
    "velocity_rad_s": "velocities",
    "acceleration_rad_s2": "accelerations",
}
"""Fields of a desired trajectory, of a trial's goal too; their names in ROS's own trajectories."""


def to_time(ns: int) -> Time:
    """Return nanoseconds as a time stamp."""
    return Time(sec=ns // NS_PER_S, nanosec=ns % NS_PER_S)


def to_duration(ns: int) -> Duration:
    """Return nanoseconds as a duration."""
    return Duration(sec=ns // NS_PER_S, nanosec=ns % NS_PER_S)


def to_array(values: FloatArray) -> array[float]:
    """Return doubles in the form that messages take without looking at each of them."""
    return array("d", values.tobytes())


def joint_state_numbers(message: JointState) -> JointStateNumbers:
    """Return what a joint state says."""
    stamp_ns = time_ns(message.header.stamp)
    return JointStateNumbers(message.name, stamp_ns, message.position, message.velocity, message.effort)


def joint_state_reader() -> Callable[[bytes], JointStateNumbers]:
    """Return a reader of joint states as bytes; what rclpy cannot read is a StateError."""
    return message_reader(
        JointStateLayout, lambda raw: joint_state_numbers(_deserialised(raw, JointState, "joint state"))
    )


def command_reader() -> Callable[[bytes], CommandNumbers]:
    """Return a reader of commands as bytes; what rclpy cannot read is a StateError."""

    def otherwise(raw: bytes) -> CommandNumbers:
        message = _deserialised(raw, Float64MultiArray, "command")
        labels = [dimension.label for dimension in message.layout.dim]
        # Of several labels the first that can be the stamp of a joint state.
        label = next((label for label in labels if label.isdecimal()), next(iter(labels), ""))
        return CommandNumbers(label.encode(), tuple(message.data))

    return message_reader(CommandLayout, otherwise)


def _deserialised(raw: bytes, kind: type, what: str) -> Any:
    try:
        return deserialize_message(raw, kind)
    except RuntimeError as error:
        raise StateError(f"no {what} in {counted(len(raw), 'byte')} ({error})") from error


def idle_state(state: ArmState) -> ControlState:
    """Return the control state of a controller that sees the arm and commands nothing."""
    message = ControlState(phase=ControlState.IDLE, time_from_start_s=-1.0)
    message.header.stamp = to_time(state.time_ns)
    message.position_rad = to_array(state.position_rad)
    message.velocity_rad_s = to_array(state.velocity_rad_s)
    return message


def to_trajectory_message(joints: Sequence[str], times_ns: IntArray, **fields: FloatArray) -> JointTrajectory:
    """Return a trajectory message; ``fields`` of its points, each of shape (n, n_joints)."""
    points = [
        JointTrajectoryPoint(
            time_from_start=to_duration(ns),
            **{name: to_array(values[k]) for name, values in fields.items()},
        )
        for k, ns in enumerate(times_ns.tolist())
    ]
    return JointTrajectory(joint_names=list(joints), points=points)


def desired_message(joints: Sequence[str], desired: DesiredTrajectory) -> JointTrajectory:
    """Return a desired trajectory as a message."""
    values = {field: getattr(desired, name) for name, field in _DESIRED.items()}
    return to_trajectory_message(joints, desired.time_ns, **values)


def to_desired(message: JointTrajectory, joints: Sequence[str]) -> DesiredTrajectory:
    """Return the desired trajectory of a message, in the order of ``joints``; TrajectoryError: it is none."""
    columns = _columns(message.joint_names, joints)
    times_ns = np.array([time_ns(point.time_from_start) for point in message.points], dtype=np.int64)
    return DesiredTrajectory(
        times_ns, **{name: _values(message, field, columns) for name, field in _DESIRED.items()}
    )


def equilibrium_of(message: JointTrajectory, joints: Sequence[str]) -> FloatArray:
    """Return the equilibrium points of a message, shape (n, n_joints); TrajectoryError: there are none."""
    return _values(message, "positions", _columns(message.joint_names, joints))


def to_goal_message(
    goal: TrialGoal, joints: Sequence[str], std_rad: Sequence[float] = ()
) -> TrialGoalMessage:
    """Return the goal of a trial as a message.

    ``std_rad``, the standard deviation of the error in the equilibrium, is flat, point by point, or empty.
    """
    doubles = {name: getattr(goal.desired, name) for name in _DESIRED}
    if goal.springs is not None:
        doubles |= vars(goal.springs)
    return TrialGoalMessage(
        trial=goal.index,
        alpha=goal.alpha,
        joint_names=list(joints),
        time_ns=array("q", goal.desired.time_ns.tobytes()),
        equilibrium_rad=to_array(goal.equilibrium_rad),
        std_rad=std_rad,
        **{name: to_array(values) for name, values in doubles.items()},
    )


def to_goal(message: TrialGoalMessage, joints: Sequence[str]) -> TrialGoal:
    """Return the goal of a trial; TrajectoryError: other joints, or arrays that do not fit together."""
    columns = _columns(message.joint_names, joints)
    shape = (len(message.time_ns), len(columns))

    def values(name: str) -> FloatArray:
        flat = getattr(message, name)
        if len(flat) != shape[0] * shape[1]:
            raise TrajectoryError(
                f"{name} has {counted(len(flat), 'value')}; expected {counted(shape[0], 'point')} "
                f"of {counted(shape[1], 'joint')}"
            )
        return np.array(flat).reshape(shape)[:, columns]

    times_ns = np.array(message.time_ns, dtype=np.int64)
    desired = DesiredTrajectory(times_ns, **{name: values(name) for name in _DESIRED})
    springs = None
    given = {field.name: np.array(getattr(message, field.name)) for field in fields(Springs)}
    if any(map(len, given.values())):
        for name, of_joints in given.items():
            if len(of_joints) != len(columns):
                raise TrajectoryError(
                    f"{name} has {counted(len(of_joints), 'value')}; expected {len(columns)}, one a joint, "
                    "or none in both stiffness and damping"
                )
        springs = Springs(**{name: of_joints[columns] for name, of_joints in given.items()})
    return TrialGoal(message.trial, message.alpha, desired, values("equilibrium_rad"), springs)


def to_result_message(report: TrialReport, joints: Sequence[str]) -> TrialResult:
    """Return a report as a message."""
    return TrialResult(joint_names=list(joints), **result_fields(report, to_time))


def _columns(names: Sequence[str], joints: Sequence[str]) -> list[int]:
    """Return the column of each of the arm's joints in a trajectory."""
    if sorted(names) != sorted(joints):
        raise TrajectoryError(
            f"the trajectory is for the joints {', '.join(names) or '(none)'}; expected {', '.join(joints)}"
        )
    return [names.index(joint) for joint in joints]


def _values(message: JointTrajectory, field: str, columns: list[int]) -> FloatArray:
    values = np.full((len(message.points), len(columns)), np.nan)
    for k, point in enumerate(message.points):
        row = getattr(point, field)
        if len(row) != len(columns):
            raise TrajectoryError(f"point {k} has {len(row)} {field}; expected {len(columns)}")
        values[k] = row
    return values[:, columns]
