"""Between ROS messages and the records of the core."""

from __future__ import annotations

from array import array
from collections.abc import Sequence

import numpy as np
from builtin_interfaces.msg import Duration, Time
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, MultiArrayDimension
from tel_interfaces.msg import ControlState, TrialResult
from tel_interfaces.msg import TrialGoal as TrialGoalMessage
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from tel_ros.core.config import ArmConfig, ControlConfig
from tel_ros.core.control.records import ArmState, Tick, TrialGoal, TrialReport
from tel_ros.core.control.springs import Springs
from tel_ros.core.control.velocity import MissingVelocities, VelocityEstimator
from tel_ros.core.errors import StateError, TrajectoryError
from tel_ros.core.safety.plausible import Plausibility
from tel_ros.core.safety.state_order import StateOrder
from tel_ros.core.trajectories.trajectory import DesiredTrajectory
from tel_ros.core.types import NS_PER_S, FloatArray, IntArray
from tel_ros.recording.trial_timing import timing_fields


def time_ns(stamp: Time | Duration) -> int:
    """Return a time or duration in nanoseconds."""
    return int(stamp.sec) * NS_PER_S + int(stamp.nanosec)


def to_time(ns: int) -> Time:
    """Return nanoseconds as a time stamp."""
    return Time(sec=ns // NS_PER_S, nanosec=ns % NS_PER_S)


def to_array(values: FloatArray) -> array[float]:
    """Return doubles in the form that messages take without looking at each of them."""
    return array("d", values.tobytes())


class JointStateReader:
    """Picks the arm's joints out of joint states, by name.

    Velocities that the arm does not tell (the field is empty, or NaN for a joint) are estimated.

    Args:
        arm: names, in the order of all arrays, and velocity limits, filled from the URDF where empty.
        control: how to estimate velocities, and for how long a state is awaited.
    """

    def __init__(self, arm: ArmConfig, control: ControlConfig) -> None:
        self._joints = list(arm.joints)
        self._velocities = MissingVelocities(
            VelocityEstimator(
                len(self._joints), cutoff_hz=control.velocity_filter_hz, max_gap_s=control.state_timeout_s
            )
        )
        self._order = StateOrder(control.state_timeout_s)
        self._plausibility = Plausibility(
            self._joints, np.array(arm.velocity_limit_rad_s), control.state_timeout_s
        )
        self._names: list[str] | None = None
        self._columns: list[int] | slice = slice(None)

    @property
    def estimated(self) -> tuple[str, ...]:
        """Joints whose velocity is estimated at present."""
        return tuple(self._joints[k] for k in self._velocities.estimated)

    def read(self, message: JointState) -> ArmState:
        """Return the state of the arm's joints.

        Raises:
            StateError: a joint is missing, a field has the wrong length, a value is not finite or cannot be,
                or a newer state has come before.
        """
        names = message.name
        if names != self._names:
            missing = [joint for joint in self._joints if joint not in names]
            if missing:
                found = ", ".join(names) or "no joints"
                raise StateError(f"the joint state has {found}; expected also {', '.join(missing)}")
            columns = [names.index(joint) for joint in self._joints]
            self._columns = slice(None) if columns == list(range(len(names))) else columns
            self._names = list(names)
        if len(message.position) != len(names) or len(message.velocity) not in (len(names), 0):
            raise StateError(
                f"the joint state has {len(names)} names, {len(message.position)} positions and "
                f"{len(message.velocity)} velocities; expected as many of each, or no velocities"
            )
        stamp_ns = time_ns(message.header.stamp)
        position_rad = np.array(message.position)[self._columns]
        overtaken_by_s = self._order.overtaken_by_s(stamp_ns)
        if overtaken_by_s:
            raise StateError(f"the joint state is {overtaken_by_s:.3f} s older than one that came before it")
        velocity = np.array(message.velocity) if message.velocity else np.full(len(names), np.nan)
        velocity = velocity[self._columns]
        self._plausibility.require(stamp_ns, position_rad, velocity)
        velocity_rad_s = self._velocities.fill(stamp_ns, position_rad, velocity)
        return ArmState(time_ns=stamp_ns, position_rad=position_rad, velocity_rad_s=velocity_rad_s)


class CommandFiller:
    """The command (efforts, or equilibrium points), marked with the stamp of the joint state that it answers.

    Stock controllers do not look at the layout of the array. The simulated arm in lockstep and the
    recorder do: its one dimension is labelled with that stamp, in nanoseconds.

    Args:
        n_joints: number of values.
    """

    def __init__(self, n_joints: int) -> None:
        self._dimension = MultiArrayDimension(size=n_joints, stride=n_joints)
        self.message = Float64MultiArray()
        self.message.layout.dim = [self._dimension]

    def fill(self, label: str, values: FloatArray) -> Float64MultiArray:
        """Return the message, which is the same one every time."""
        self._dimension.label = label
        self.message.data = to_array(values)
        return self.message


def answered_stamp_ns(message: Float64MultiArray) -> int | None:
    """Return the stamp of the joint state that a command answers, or None if it does not say."""
    for dimension in message.layout.dim:
        if dimension.label.isdecimal():
            return int(dimension.label)
    return None


class ControlStateFiller:
    """Turns ticks into one message that is used again and again."""

    def __init__(self) -> None:
        self._message = ControlState()

    def fill(self, trial: int, state: ArmState, tick: Tick) -> ControlState:
        """Return the message, which is the same one every time."""
        message = self._message
        stamp = message.header.stamp
        stamp.sec, stamp.nanosec = divmod(state.time_ns, NS_PER_S)
        message.trial = trial
        message.phase = int(tick.phase)
        message.time_from_start_s = tick.time_from_start_s
        message.desired_position_rad = to_array(tick.desired_position_rad)
        message.desired_velocity_rad_s = to_array(tick.desired_velocity_rad_s)
        message.desired_acceleration_rad_s2 = to_array(tick.desired_acceleration_rad_s2)
        message.equilibrium_rad = to_array(tick.equilibrium_rad)
        message.position_rad = to_array(state.position_rad)
        message.velocity_rad_s = to_array(state.velocity_rad_s)
        message.effort_nm = to_array(tick.effort_nm)
        message.saturated = tick.saturated.tolist()
        return message


def idle_state(state: ArmState) -> ControlState:
    """Return the control state of a controller that sees the arm and commands nothing."""
    message = ControlState(phase=ControlState.IDLE, time_from_start_s=-1.0)
    message.header.stamp = to_time(state.time_ns)
    message.position_rad = to_array(state.position_rad)
    message.velocity_rad_s = to_array(state.velocity_rad_s)
    return message


def to_trajectory_message(
    joints: Sequence[str],
    times_ns: IntArray,
    position_rad: FloatArray,
    velocity_rad_s: FloatArray | None = None,
    acceleration_rad_s2: FloatArray | None = None,
) -> JointTrajectory:
    """Return a trajectory message; arrays of shape (n, n_joints), missing ones are left empty."""
    message = JointTrajectory(joint_names=list(joints))
    for k, ns in enumerate(times_ns.tolist()):
        point = JointTrajectoryPoint(positions=to_array(position_rad[k]))
        if velocity_rad_s is not None:
            point.velocities = to_array(velocity_rad_s[k])
        if acceleration_rad_s2 is not None:
            point.accelerations = to_array(acceleration_rad_s2[k])
        point.time_from_start = Duration(sec=ns // NS_PER_S, nanosec=ns % NS_PER_S)
        message.points.append(point)
    return message


def desired_message(joints: Sequence[str], desired: DesiredTrajectory) -> JointTrajectory:
    """Return a desired trajectory as a message."""
    return to_trajectory_message(
        joints,
        desired.time_ns,
        desired.position_rad,
        desired.velocity_rad_s,
        desired.acceleration_rad_s2,
    )


def to_desired(message: JointTrajectory, joints: Sequence[str]) -> DesiredTrajectory:
    """Return the desired trajectory of a message, its columns in the order of ``joints``.

    Raises:
        TrajectoryError: other joints, points without positions, velocities or accelerations, or whatever
            :class:`DesiredTrajectory` refuses.
    """
    columns = _columns(message.joint_names, joints)
    return DesiredTrajectory(
        time_ns=np.array([time_ns(point.time_from_start) for point in message.points], dtype=np.int64),
        position_rad=_values(message, "positions", columns),
        velocity_rad_s=_values(message, "velocities", columns),
        acceleration_rad_s2=_values(message, "accelerations", columns),
    )


def to_goal_message(
    trial: int,
    alpha: float,
    joints: Sequence[str],
    desired: DesiredTrajectory,
    equilibrium_rad: FloatArray,
    std_rad: Sequence[float] = (),
    springs: Springs | None = None,
) -> TrialGoalMessage:
    """Return the goal of a trial as a message.

    Args:
        trial: number of the trial.
        alpha: practice parameter.
        joints: names, in the order of all columns.
        desired: y.
        equilibrium_rad: û. Shape (n, n_joints).
        std_rad: standard deviation of the error in û, flat, point by point; or empty.
        springs: K and B; None: as configured.
    """
    return TrialGoalMessage(
        trial=trial,
        alpha=alpha,
        joint_names=list(joints),
        time_ns=array("q", desired.time_ns.tobytes()),
        position_rad=to_array(desired.position_rad),
        velocity_rad_s=to_array(desired.velocity_rad_s),
        acceleration_rad_s2=to_array(desired.acceleration_rad_s2),
        equilibrium_rad=to_array(equilibrium_rad),
        stiffness_nm_per_rad=to_array(springs.stiffness_nm_per_rad) if springs else (),
        damping_nms_per_rad=to_array(springs.damping_nms_per_rad) if springs else (),
        std_rad=std_rad,
    )


def to_goal(message: TrialGoalMessage, joints: Sequence[str]) -> TrialGoal:
    """Return the goal of a trial.

    Raises:
        TrajectoryError: other joints, arrays that do not fit together, or whatever
            :class:`DesiredTrajectory`, :class:`Springs` and :class:`TrialGoal` refuse.
    """
    columns = _columns(message.joint_names, joints)
    shape = (len(message.time_ns), len(columns))

    def values(name: str) -> FloatArray:
        flat = getattr(message, name)
        if len(flat) != shape[0] * shape[1]:
            raise TrajectoryError(
                f"{name} has {len(flat)} values; expected {shape[0]} points of {shape[1]} joints"
            )
        return np.array(flat).reshape(shape)[:, columns]

    desired = DesiredTrajectory(
        time_ns=np.array(message.time_ns, dtype=np.int64),
        position_rad=values("position_rad"),
        velocity_rad_s=values("velocity_rad_s"),
        acceleration_rad_s2=values("acceleration_rad_s2"),
    )
    springs = None
    if len(message.stiffness_nm_per_rad) or len(message.damping_nms_per_rad):
        for name in ("stiffness_nm_per_rad", "damping_nms_per_rad"):
            if len(getattr(message, name)) != len(columns):
                raise TrajectoryError(
                    f"{name} has {len(getattr(message, name))} values; expected {len(columns)}, one a joint, "
                    "or none in both stiffness and damping"
                )
        springs = Springs(
            np.array(message.stiffness_nm_per_rad)[columns], np.array(message.damping_nms_per_rad)[columns]
        )
    return TrialGoal(message.trial, message.alpha, desired, values("equilibrium_rad"), springs)


def to_result_message(report: TrialReport, joints: Sequence[str]) -> TrialResult:
    """Return a report as a message."""
    return TrialResult(
        index=report.index,
        outcome=int(report.outcome),
        message=report.message,
        alpha=report.alpha,
        duration_s=report.duration_s,
        start_stamp=to_time(report.start_ns),
        run_stamp=to_time(report.run_ns),
        end_stamp=to_time(report.end_ns),
        ticks=report.ticks,
        joint_names=list(joints),
        rms_error_rad=report.rms_error_rad,
        rms_error_per_joint_rad=to_array(report.rms_error_per_joint_rad),
        max_error_rad=report.max_error_rad,
        max_effort_nm=to_array(report.max_effort_nm),
        saturated_ratio=report.saturated_ratio,
        **timing_fields(report.timing),
    )


def _columns(names: Sequence[str], joints: Sequence[str]) -> list[int]:
    """Return where each of the arm's joints stands in a trajectory."""
    if sorted(names) != sorted(joints):
        raise TrajectoryError(
            f"the trajectory is for the joints {', '.join(names) or '(none)'}; expected {', '.join(joints)}"
        )
    return [names.index(joint) for joint in joints]


def equilibrium_of(message: JointTrajectory, joints: Sequence[str]) -> FloatArray:
    """Return the equilibrium points of a message. Shape (n, n_joints).

    Raises:
        TrajectoryError: other joints, or points without positions.
    """
    return _values(message, "positions", _columns(message.joint_names, joints))


def _values(message: JointTrajectory, field: str, columns: list[int]) -> FloatArray:
    values = np.full((len(message.points), len(columns)), np.nan)
    for k, point in enumerate(message.points):
        row = getattr(point, field)
        if len(row) != len(columns):
            raise TrajectoryError(f"point {k} has {len(row)} {field}; expected {len(columns)}")
        values[k] = row
    return values[:, columns]
