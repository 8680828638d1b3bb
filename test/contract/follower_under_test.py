"""A joint_trajectory_controller that is running, and a client beside it."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from types import TracebackType
from typing import Any

import numpy as np
import rclpy
from action_msgs.msg import GoalStatus
from arm_under_test import catch_up, spin_until
from control_msgs.action import FollowJointTrajectory
from control_msgs.msg import JointTolerance, JointTrajectoryControllerState
from rcl_interfaces.srv import GetParameters
from rclpy.action import ActionClient
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python
from rclpy.task import Future
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from tel_ros.core.config import Config
from tel_ros.core.types import FloatArray
from tel_ros.nodes.conversions import time_ns, to_duration
from tel_ros.recording import topics

SWING_RAD = 0.03
START_S, ANSWER_S = 20.0, 20.0


class FollowerUnderTest:
    """Use it with ``with``. Movements go ``SWING_RAD`` from where the arm was found, and back."""

    def __init__(self, config: Config) -> None:
        self.config, self.joints = config, config.arm.joints
        self.name = config.arm.trajectory_controller
        self.states: list[JointTrajectoryControllerState] = []
        self.feedback: list[FollowJointTrajectory.Feedback] = []
        self._context = Context()
        self._last_nm: dict[bytes, FloatArray] = {}
        self.reached_nm = np.zeros(len(self.joints))
        """Efforts of the last point of the last goal that was reached."""

    def __enter__(self) -> FollowerUnderTest:
        """Wait for it."""
        rclpy.init(context=self._context)
        self.node = Node("contract_test", context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        kind, topic = JointTrajectoryControllerState, f"{self.name}/{topics.CONTROLLER_STATE}"
        self.node.create_subscription(kind, topic, self.states.append, 5000)
        trajectories = f"{self.name}/{topics.JOINT_TRAJECTORY_COMMANDS}"
        self.publisher = self.node.create_publisher(JointTrajectory, trajectories, 1)
        action = f"{self.name}/{topics.FOLLOW_JOINT_TRAJECTORY}"
        self._client = ActionClient(self.node, FollowJointTrajectory, action)
        self.spin_until(self._client.server_is_ready, START_S, f"the action {action}")
        self.gains = {
            key: np.array([self.parameter(f"gains.{joint}.{key}") for joint in self.joints]) for key in "pd"
        }
        # A goal that stays where the arm is; which states it makes tells where that is.
        end = time.monotonic() + 1.0
        self.spin_until(lambda: bool(self.states) or time.monotonic() > end, ANSWER_S, "a second")
        if self.states:
            self.home_rad = self._row(self.states[-1].feedback.positions)
        else:
            self.home_rad = self.position_rad()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Go."""
        self._client.destroy()
        self.node.destroy_node()
        self._context.try_shutdown()

    def spin_until(self, condition: Callable[[], bool], timeout_s: float, what: str) -> None:
        """Spin until a condition holds; fail the test when it does not come."""
        spin_until(self._executor, condition, timeout_s, what)

    def catch_up(self) -> None:
        """Take what has come while nobody spun: in lockstep that may be minutes of its time."""
        catch_up(self._executor, self.states)

    def wait(self, future: Future, what: str) -> Any:
        """Return the result of a future."""
        self.spin_until(future.done, ANSWER_S, what)
        return future.result()

    def position_rad(self) -> FloatArray:
        """Return where the arm is, from its joint states."""
        from sensor_msgs.msg import JointState

        heard: list[JointState] = []
        subscription = self.node.create_subscription(JointState, topics.JOINT_STATES, heard.append, 1)
        self.spin_until(lambda: bool(heard), ANSWER_S, "a joint state")
        self.node.destroy_subscription(subscription)
        return np.array([heard[-1].position[list(heard[-1].name).index(joint)] for joint in self.joints])

    def parameter(self, name: str) -> Any:
        """Return one of its parameters."""
        client = self.node.create_client(GetParameters, f"{self.name}/get_parameters")
        self.spin_until(client.service_is_ready, START_S, "its parameters")
        answer = self.wait(client.call_async(GetParameters.Request(names=[name])), name)
        self.node.destroy_client(client)
        return parameter_value_to_python(answer.values[0])

    def swing(self, duration_s: float, effort_nm: Sequence[float] = ()) -> JointTrajectory:
        """Return a movement there and back again, from rest to rest, with constant efforts if any."""
        message = JointTrajectory(joint_names=list(self.joints))
        for t in np.linspace(0.0, duration_s, 9):
            w = 2.0 * np.pi / duration_s
            rows = 0.5 * SWING_RAD * np.array([1.0 - np.cos(w * t), w * np.sin(w * t), w * w * np.cos(w * t)])
            if t == duration_s:
                rows[1] = 0.0
            position, velocity, acceleration = (np.full(len(self.joints), row) for row in rows)
            point = JointTrajectoryPoint(time_from_start=to_duration(round(t * 1e9)))
            point.positions = (self.home_rad + position).tolist()
            point.velocities, point.accelerations = velocity.tolist(), acceleration.tolist()
            point.effort = list(effort_nm)
            message.points.append(point)
        return message

    def goal(self, trajectory: JointTrajectory, **tolerances_rad: float) -> FollowJointTrajectory.Goal:
        """Return a goal; ``path`` and ``goal``: tolerances of all joints, else none."""
        goal = FollowJointTrajectory.Goal(trajectory=trajectory)
        for kind in ("path", "goal"):
            position = tolerances_rad.get(kind, -1.0)
            of_all = [JointTolerance(name=joint, position=position, velocity=-1.0) for joint in self.joints]
            setattr(goal, f"{kind}_tolerance", of_all)
        goal.goal_time_tolerance = to_duration(round(tolerances_rad.get("time_s", 2.0) * 1e9))
        return goal

    def send(self, goal: FollowJointTrajectory.Goal, *, at_once: bool = False) -> Any:
        """Send a goal and return its handle; ``at_once``: although states of another one may keep coming."""
        if not at_once:
            self.catch_up()
        self.states.clear()
        self.feedback.clear()
        sent = self._client.send_goal_async(goal, lambda message: self.feedback.append(message.feedback))
        handle = self.wait(sent, "the answer to a goal")
        last = goal.trajectory.points[-1].effort if goal.trajectory.points else ()
        self._last_nm[bytes(handle.goal_id.uuid)] = (
            np.array(last) if len(last) else np.zeros(len(self.joints))
        )
        return handle

    def end(self, handle: Any) -> tuple[int, FollowJointTrajectory.Result]:
        """Return status and result of a goal."""
        assert handle.accepted
        answer = self.wait(handle.get_result_async(), "the result of a goal")
        if answer.status == GoalStatus.STATUS_SUCCEEDED:
            self.reached_nm = self._last_nm[bytes(handle.goal_id.uuid)]
        return answer.status, answer.result

    def follow(self, goal: FollowJointTrajectory.Goal) -> tuple[int, FollowJointTrajectory.Result]:
        """Send a goal and return how it ended."""
        return self.end(self.send(goal))

    def told(self) -> dict[str, FloatArray]:
        """Return the controller states since the newest goal was sent: rows of time and joint.

        ``q``, ``dq``: measured; ``y``, ``dy``: wanted; ``e``, ``de``: between them; ``effort``; ``stamp_ns``
        and ``since_ns``, from the start of the trajectory.
        """
        fields = {
            "q": ("feedback", "positions"),
            "dq": ("feedback", "velocities"),
            "y": ("reference", "positions"),
            "dy": ("reference", "velocities"),
            "e": ("error", "positions"),
            "de": ("error", "velocities"),
            "effort": ("output", "effort"),
        }
        told = {
            key: np.array([self._row(getattr(getattr(state, part), field)) for state in self.states])
            for key, (part, field) in fields.items()
        }
        told["stamp_ns"] = np.array([time_ns(state.header.stamp) for state in self.states])
        told["since_ns"] = np.array([time_ns(state.reference.time_from_start) for state in self.states])
        return told

    def _row(self, values: Sequence[float]) -> FloatArray:
        names = list(self.states[-1].joint_names)
        return np.array([values[names.index(joint)] for joint in self.joints])
