"""A stand-in for a running joint_trajectory_controller of ros2_control: node, action, topics, parameters."""

from __future__ import annotations

import time
from functools import partial

import numpy as np
from control_msgs.action import FollowJointTrajectory
from control_msgs.msg import JointTrajectoryControllerState
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.node import Node
from rclpy.parameter import Parameter
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from sim_bridge.arm import ArmReading
from sim_bridge.splines import FIELDS, Points, points_of
from sim_bridge.trajectory_control import CANCELLED, Code, End, Gains, Tolerances, TrajectoryController
from tel_ros.core.config import ArmConfig
from tel_ros.core.errors import TrajectoryError
from tel_ros.nodes import qos
from tel_ros.nodes.conversions import to_array, to_duration, to_time
from tel_ros.recording import topics
from tel_ros.recording.cdr import ControllerStateLayout

_END = "allow_nonzero_velocity_at_trajectory_end"
_FROM_COMMAND = "interpolate_from_desired_state"
_RATE, _STOPPED, _GOAL_TIME = (
    "action_monitor_rate",
    "constraints.stopped_velocity_tolerance",
    "constraints.goal_time",
)


class TrajectoryServer(Node):
    """Makes efforts of trajectories, one for each state that it is asked about; a node of its own.

    Its gains are K and B of the arm, if its parameters do not say otherwise. Gains and constraints may be set
    while it runs, as those of the real one.
    """

    def __init__(
        self, arm: ArmConfig, rate_hz: float, namespace: str, reading: ArmReading, now_ns: int
    ) -> None:
        above, _, name = arm.trajectory_controller.rpartition("/")
        within = "/".join(("", *filter(None, (*namespace.split("/"), *above.split("/"))))) or "/"
        # The process may have been given a name: that of the arm's own node.
        named = ["--ros-args", "-r", f"__node:={name}", "-r", f"__ns:={within}"]
        super().__init__(name, namespace=within, cli_args=named)
        self._arm = arm
        self._declare(rate_hz)
        starts_from_command = self.get_parameter(_FROM_COMMAND).value
        self._law = TrajectoryController(
            arm.joints, rate_hz, self._gains(), starts_from_command=starts_from_command
        )
        self._considered: Points
        self._handle: ServerGoalHandle | None = None
        self._feedback_due_s = 0.0
        self._untold = 0
        self._states = self.create_publisher(
            JointTrajectoryControllerState, f"~/{topics.CONTROLLER_STATE}", qos.STREAM
        )
        self._layout = ControllerStateLayout(arm.joints)
        self.create_subscription(
            JointTrajectory, f"~/{topics.JOINT_TRAJECTORY_COMMANDS}", self._on_trajectory, qos.EVENTS
        )
        self._update(reading, now_ns)
        self._server = ActionServer(
            self,
            FollowJointTrajectory,
            f"~/{topics.FOLLOW_JOINT_TRAJECTORY}",
            self._never,
            goal_callback=self._consider,
            handle_accepted_callback=self._take_up,
            cancel_callback=self._cancel,
        )
        self.add_post_set_parameters_callback(self._on_set)

    def destroy_node(self) -> None:
        """Take the action back, too."""
        self._server.destroy()
        super().destroy_node()

    @property
    def moves(self) -> bool:
        """Whether there is a trajectory to follow."""
        return self._law.moves

    def answer(self, reading: ArmReading, now_ns: int, told_every: int = 1) -> list[float]:
        """Return the effort of each joint in N·m until the next state.

        ``now_ns``: the stamp of the state. ``told_every``: of so many states the controller state is told.
        """
        ended = self._update(reading, now_ns)
        self._untold += 1
        if self._untold >= told_every:
            self._untold = 0
            self._tell(now_ns)
        # By the clock on the wall, as the real one does.
        if self._handle is not None and time.monotonic() >= self._feedback_due_s:
            self._feedback_due_s = time.monotonic() + 1.0 / self.get_parameter(_RATE).value
            self._handle.publish_feedback(self._feedback(now_ns))
        if ended is not None:
            self._finish(ended)
        return self._law.effort_nm.tolist()

    def _update(self, reading: ArmReading, now_ns: int) -> End | None:
        return self._law.update(now_ns, reading.position_rad, reading.velocity_rad_s)

    def _tell(self, now_ns: int) -> None:
        law = self._law
        rows = (
            *law.desired[:3].tolist(),
            *law.measured.tolist(),
            *law.error.tolist(),
            law.effort_nm.tolist(),
        )
        self._states.publish(self._layout.packed(now_ns, now_ns - law.start_ns, *rows))

    # Goals.

    def _points(self, trajectory: JointTrajectory) -> Points:
        """Return its points; TrajectoryError: it cannot be followed."""
        now_ns = self._law.time_ns or 0
        return points_of(trajectory, self._arm.joints, now_ns, ends_moving=self.get_parameter(_END).value)

    def _consider(self, goal: FollowJointTrajectory.Goal) -> GoalResponse:
        try:
            self._considered = self._points(goal.trajectory)  # reading a long one twice takes too long
        except TrajectoryError as error:
            self.get_logger().error(f"goal rejected: {error}")
            return GoalResponse.REJECT
        return GoalResponse.ACCEPT

    def _take_up(self, handle: ServerGoalHandle) -> None:
        goal = handle.request
        tolerances = self._tolerances().asked_for(goal, self._arm.joints)
        for remark in tolerances.remarks:
            self.get_logger().error(remark)
        if preempted := self._law.follow(self._considered, tolerances):
            self._finish(preempted)
        self._handle, self._feedback_due_s = handle, 0.0

    def _cancel(self, handle: ServerGoalHandle) -> CancelResponse:
        if self._handle is not None and handle.goal_id == self._handle.goal_id:
            self._finish(self._law.cancel())
        return CancelResponse.ACCEPT

    def _finish(self, ended: End) -> None:
        if ended.why:
            self.get_logger().warning(f"{ended.text}: {ended.why}; the arm is held where it is")
        handle, self._handle = self._handle, None
        if handle is not None:
            # At the end only: an execute callback that waited for it would keep the executor polling.
            handle.execute(partial(_end_goal, ended))

    def _never(self, handle: ServerGoalHandle) -> FollowJointTrajectory.Result:
        raise NotImplementedError("goals are ended by _finish")

    def _on_trajectory(self, trajectory: JointTrajectory) -> None:
        try:
            self._law.follow(self._points(trajectory))
        except TrajectoryError as error:
            self.get_logger().error(f"trajectory ignored: {error}")

    def _feedback(self, now_ns: int) -> FollowJointTrajectory.Feedback:
        law = self._law
        feedback = FollowJointTrajectory.Feedback(joint_names=list(self._arm.joints))
        feedback.header.stamp = to_time(now_ns)
        since = to_duration(now_ns - law.start_ns)
        for name, values in (("desired", law.desired), ("actual", law.measured), ("error", law.error)):
            rows = {field: to_array(row) for field, row in zip(FIELDS, values, strict=False)}
            setattr(feedback, name, JointTrajectoryPoint(time_from_start=since, **rows))
        return feedback

    # Parameters.

    def _declare(self, rate_hz: float) -> None:
        fixed, arm = ParameterDescriptor(read_only=True), self._arm
        self.declare_parameter("joints", list(arm.joints), fixed)
        self.declare_parameter("command_interfaces", ["effort"], fixed)
        self.declare_parameter("state_interfaces", ["position", "velocity"], fixed)
        self.declare_parameter("update_rate", round(rate_hz), fixed)
        self.declare_parameter(_FROM_COMMAND, False, fixed)
        self.declare_parameter(_RATE, 20.0, fixed)
        self.declare_parameter(_END, False)
        self.declare_parameter(_STOPPED, 0.01)
        self.declare_parameter(_GOAL_TIME, 0.0)
        for joint, p, d in zip(arm.joints, arm.stiffness_nm_per_rad, arm.damping_nms_per_rad, strict=True):
            gains = {"p": p, "i": 0.0, "d": d, "ff_velocity_scale": 0.0}
            for name, value in gains.items():
                self.declare_parameter(f"gains.{joint}.{name}", float(value))
            for name in ("trajectory", "goal"):
                self.declare_parameter(f"constraints.{joint}.{name}", 0.0)

    def _values(self, section: str, name: str) -> list[float]:
        return [self.get_parameter(f"{section}.{joint}.{name}").value for joint in self._arm.joints]

    def _gains(self) -> Gains:
        return Gains(
            *(np.array(self._values("gains", name)) for name in ("p", "i", "d", "ff_velocity_scale"))
        )

    def _tolerances(self) -> Tolerances:
        path, goal = (self._values("constraints", name) for name in ("trajectory", "goal"))
        return Tolerances.of(path, goal, *(self.get_parameter(name).value for name in (_STOPPED, _GOAL_TIME)))

    def _on_set(self, parameters: list[Parameter]) -> None:
        self._law.gains = self._gains()


def _end_goal(ended: End, handle: ServerGoalHandle) -> FollowJointTrajectory.Result:
    if ended is CANCELLED:
        handle.canceled()
    elif ended.code is Code.SUCCESSFUL:
        handle.succeed()
    else:
        handle.abort()
    return FollowJointTrajectory.Result(error_code=int(ended.code), error_string=ended.text)
