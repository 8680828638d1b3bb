"""A FollowJointTrajectory action that gets better: trajectories of others, with what has been learned."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from control_msgs.action import FollowJointTrajectory
from control_msgs.msg import JointTolerance
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from sensor_msgs.msg import JointState
from tel_interfaces.msg import ControlState
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from tel_ros.core.control.trajectory_points import ErrorCode
from tel_ros.core.errors import ConfigError, TelError
from tel_ros.core.serving.reference import Points, RefusedError, requested
from tel_ros.core.serving.session import Decision, Served, ServingSession
from tel_ros.core.serving.tolerances import exceeded, tolerances
from tel_ros.core.trial import Outcome
from tel_ros.core.types import FloatArray
from tel_ros.nodes.conversions import time_ns
from tel_ros.nodes.diagnostics import Diagnostics, Health, Level
from tel_ros.nodes.parameters import CONFIG, load_parameters
from tel_ros.nodes.practice_ports import ReadyArm, RunContext
from tel_ros.nodes.runner import run_node
from tel_ros.nodes.serving.service_ports import Newest, ServicePorts, Silent
from tel_ros.nodes.waiting import NoAnswerError, PatientExecutor
from tel_ros.recording import topics
from tel_ros.recording.run_folder import CONFIG_FILE
from tel_ros.recording.service_folder import open_service

PREEMPTED = "Current goal cancelled due to new incoming action."
DONE = "Goal successfully reached!"
OFF_PATH = "Aborted due to path tolerance violation"
OFF_GOAL = "Aborted due to goal_time_tolerance exceeding"
STATE_TIMEOUT_S = 2.0
STOPPING_TIMEOUT_S = 2.5
MEETING_TIMEOUT_S = 20.0
"""The network's process takes some seconds to start."""
THREADS = 16
"""One executes; the others wait for their turn, and serve what it waits for."""


class _EndedError(TelError):
    """A goal ends before its turn, or instead of its success; ``status``: abort or canceled."""

    def __init__(self, reason: str, code: ErrorCode = ErrorCode.INVALID_GOAL, status: str = "abort") -> None:
        self.code, self.status = code, status
        super().__init__(reason)


class FeedforwardControllerNode(Node):
    """Executes one trajectory at a time; a new goal that is valid takes the place of the one under way.

    Every goal is accepted and gets a result: a rejection carries no reason.
    """

    def __init__(self) -> None:
        super().__init__("feedforward_controller")
        sections = ("arm", "path", "run", "practice", "learning", "control", "sim", "serve", "seed")
        self._config = load_parameters(self, *sections)
        self._open = ExitStack()
        self._folder = self._open.enter_context(open_service(self._named_folder(), self._config))
        group = ReentrantCallbackGroup()
        self._joint_states = Newest(self, JointState, topics.JOINT_STATES)
        self._control_states = Newest(self, ControlState, topics.CONTROL_STATES)
        self._arm = ReadyArm(self, group, self._config)
        self._ports = ServicePorts(self, group, self._config, self._arm.wait, self._watch)
        folder = self._folder
        self._ports.run = RunContext(folder.folder, folder.written, Silent(), self._is_given_up)
        memory, problem = folder.memory()
        if problem:
            self.get_logger().error(problem)
        self._session = ServingSession(self._config, self._ports, self._ports, folder, memory)
        self._choosing, self._turn = threading.Lock(), threading.Lock()
        self._newest: ServerGoalHandle | None = None
        self._underway: _Underway | None = None
        self._goals = 0
        self._stopping_since = math.inf
        self._doing, self._last = "", Health(Level.OK, "waits for a trajectory")
        self._server = ActionServer(
            self,
            FollowJointTrajectory,
            "~/follow_joint_trajectory",
            execute_callback=self._execute,
            goal_callback=self._consider,
            cancel_callback=lambda handle: CancelResponse.ACCEPT,
            callback_group=group,
        )
        self._diagnostics = Diagnostics(self, "service", self._config.arm.name, self._health, group)
        learned = f"network after execution {memory.network}, {len(memory.movements)} movements known"
        self.get_logger().info(f"serves from {folder.folder}: {learned}")

    def stop(self) -> None:
        """Cancel what is under way."""
        self._stopping_since = time.monotonic()

    @property
    def stopped(self) -> bool:
        """Whether no goal is left without its result."""
        return self._goals == 0

    def destroy_node(self) -> None:
        """Give the folder free."""
        self._open.close()
        super().destroy_node()

    def _named_folder(self) -> Path:
        what = f"folder of networks and recordings; empty: that of {CONFIG}, if it is a {CONFIG_FILE}"
        about = ParameterDescriptor(description=what, read_only=True)
        name, config = self.declare_parameter("folder", "", about).value, self.get_parameter(CONFIG).value
        if not name and Path(config).name != CONFIG_FILE:
            raise ConfigError("folder", name, f"a folder, new or of an earlier service ({config} names none)")
        return Path(name or Path(config).parent).absolute()

    def _consider(self, goal: FollowJointTrajectory.Goal) -> GoalResponse:
        if self._stopping_since < math.inf:
            return GoalResponse.REJECT
        self._goals += 1
        return GoalResponse.ACCEPT

    def _execute(self, handle: ServerGoalHandle) -> FollowJointTrajectory.Result:
        result, level, status = FollowJointTrajectory.Result(), Level.ERROR, "abort"
        try:
            result.error_string = self._served(handle)
            level, status = Level.OK, "succeed"
        except (RefusedError, _EndedError) as error:
            result.error_code, result.error_string = int(error.code), str(error)
            level, status = Level.WARN, getattr(error, "status", status)
        except TelError as error:
            result.error_code, result.error_string = int(ErrorCode.INVALID_GOAL), str(error)
        finally:
            # Whatever else has gone wrong: a goal without a result would be waited for for ever.
            getattr(handle, status)()
            self._goals -= 1
        self._last = Health(level, result.error_string)
        if level is Level.OK:  # rclpy wants every level at a place of its own
            self.get_logger().info(result.error_string)
        else:
            self.get_logger().warning(result.error_string)
        return result

    def _served(self, handle: ServerGoalHandle) -> str:
        goal = handle.request
        points = self._points(goal.trajectory)
        if points.time_ns[0] == 0:
            self._session.reference(points, points.position_rad[0])  # what is invalid takes nobody's place
        path_rad, goal_rad = self._tolerances(goal.path_tolerance), self._tolerances(goal.goal_tolerance)
        with self._own_turn(handle) as underway:
            self._ports.bring_up(MEETING_TIMEOUT_S)
            decision = self._session.decide(points, self._position())
            underway.begin(decision, path_rad)
            self._doing = f"executes trajectory {decision.commanded.plan.index}"
            if decision.said:
                self.get_logger().info(f"{self._doing}: {decision.said}")
            return self._ended(underway, self._session.execute(decision), points, goal_rad)

    def _ended(self, underway: _Underway, served: Served[Path], points: Points, goal_rad: FloatArray) -> str:
        report, why = served.report, f"; {served.text}" if served.text else ""
        if report.outcome == Outcome.COMPLETED:
            if off := exceeded(self._config.arm.joints, self._position() - points.position_rad[-1], goal_rad):
                raise _EndedError(f"{OFF_GOAL}: {off}{why}", ErrorCode.GOAL_TOLERANCE_VIOLATED)
            return f"{DONE}{why}"
        why = f": {report.message}{why}" if report.message else why
        if underway.off_path:
            raise _EndedError(f"{OFF_PATH}: {underway.off_path}{why}", ErrorCode.PATH_TOLERANCE_VIOLATED)
        if underway.is_preempted:
            raise _EndedError(PREEMPTED)
        if report.outcome == Outcome.CANCELLED:
            if underway.handle.is_cancel_requested:
                raise _EndedError(f"cancelled{why}", ErrorCode.SUCCESSFUL, "canceled")
            raise _EndedError(f"cancelled{why}")
        if report.max_error_rad > self._config.control.path_tolerance_rad:
            raise _EndedError(f"{OFF_PATH}{why}", ErrorCode.PATH_TOLERANCE_VIOLATED)
        raise _EndedError(f"aborted{why}")

    @contextmanager
    def _own_turn(self, handle: ServerGoalHandle) -> Iterator[_Underway]:
        """Take the place of the goal that is under way, once it has ended."""
        with self._choosing:
            self._newest = handle
        while not self._turn.acquire(timeout=0.05):
            if self._newest is not handle:
                raise _EndedError(PREEMPTED)
            if handle.is_cancel_requested:
                raise _EndedError("cancelled before it began", ErrorCode.SUCCESSFUL, "canceled")
        try:
            self._underway = _Underway(handle, lambda: self._newest is not handle)
            yield self._underway
        finally:
            self._underway, self._doing = None, ""
            self._turn.release()

    def _is_given_up(self) -> bool:
        """Return whether the trial under way is to be cancelled."""
        underway = self._underway
        given_up = underway is not None and underway.is_given_up
        return given_up or self._stopping_since < math.inf

    def _watch(self) -> None:
        """Tell how the movement goes, and look at its tolerances; called several times a second."""
        if time.monotonic() - self._stopping_since > STOPPING_TIMEOUT_S:
            raise NoAnswerError("the service was ended from outside")
        if self._underway is not None and (state := self._control_states.take()) is not None:
            self._underway.hear(state, self._config.arm.joints)

    def _points(self, trajectory: JointTrajectory) -> Points:
        rows = trajectory.points
        points = requested(
            self._config.arm.joints,
            trajectory.joint_names,
            [time_ns(point.time_from_start) for point in rows],
            *(
                [getattr(point, name) for point in rows]
                for name in ("positions", "velocities", "accelerations")
            ),
        )
        if begins_ns := time_ns(trajectory.header.stamp):
            now_ns = self.get_clock().now().nanoseconds
            if begins_ns + points.time_ns[-1] < now_ns:
                raise RefusedError(
                    "Received trajectory with non-zero start time that ends in the past",
                    ErrorCode.OLD_HEADER_TIMESTAMP,
                )
            if begins_ns > now_ns:
                raise RefusedError("the trajectory begins in the future; expected a stamp of 0, for at once")
        return points

    def _tolerances(self, asked: list[JointTolerance]) -> FloatArray:
        names, positions = [each.name for each in asked], [each.position for each in asked]
        found, wrong = tolerances(self._config.arm.joints, names, positions, math.inf)
        if wrong:
            self.get_logger().error(wrong)
        return found

    def _position(self) -> FloatArray:
        """Return where the joints are now, shape (n_joints,)."""
        end = time.monotonic() + STATE_TIMEOUT_S
        self._joint_states.take()  # may be of long ago
        while (state := self._joint_states.take()) is None:
            if time.monotonic() > end:
                name = self.resolve_topic_name(topics.JOINT_STATES)
                raise NoAnswerError(f"no joint state on {name} for {STATE_TIMEOUT_S:g} s")
            time.sleep(0.005)
        joints = self._config.arm.joints
        missing = [joint for joint in joints if joint not in state.name]
        if missing:
            raise NoAnswerError(f"the joint states have no {', '.join(missing)}")
        return np.array([state.position[list(state.name).index(joint)] for joint in joints])

    def _health(self) -> Health:
        memory = self._session.memory
        values = {"network": memory.network, "executions": memory.executions, "folder": self._folder.folder}
        if self._doing:
            return Health(Level.OK, self._doing, values)
        return Health(self._last.level, self._last.message, values)


class _Underway:
    """A goal whose turn it is: what ends it early, and its feedback."""

    def __init__(self, handle: ServerGoalHandle, is_preempted: Any) -> None:
        self.handle, self._preempted = handle, is_preempted
        self.off_path = ""
        """Which joint has left its path tolerance; empty: none."""
        self._index, self._said, self._tolerance_rad = 0, "", np.zeros(0)

    @property
    def is_preempted(self) -> bool:
        """Whether a newer goal waits."""
        return bool(self._preempted())

    @property
    def is_given_up(self) -> bool:
        """Whether it has to end before it is over."""
        return self.is_preempted or self.handle.is_cancel_requested or bool(self.off_path)

    def begin(self, decision: Decision, tolerance_rad: FloatArray) -> None:
        """Begin to move."""
        self._index, self._said = decision.commanded.plan.index, decision.said
        self._tolerance_rad = tolerance_rad

    def hear(self, state: ControlState, joints: tuple[str, ...]) -> None:
        """Pass on a state of the movement: the header's frame says how much slower than requested it is."""
        if state.trial != self._index or state.phase != ControlState.RUN or not self.handle.is_active:
            return
        wanted = [state.desired_position_rad, state.desired_velocity_rad_s, state.desired_acceleration_rad_s2]
        actual = [state.position_rad, state.velocity_rad_s]
        errors = [np.subtract(*pair) for pair in zip(wanted, actual, strict=False)]
        feedback = FollowJointTrajectory.Feedback(joint_names=list(joints))
        feedback.header.stamp, feedback.header.frame_id = state.header.stamp, self._said
        for point, values in (
            (feedback.desired, wanted),
            (feedback.actual, actual),
            (feedback.error, errors),
        ):
            _fill(point, values, state.time_from_start_s)
        self.handle.publish_feedback(feedback)
        self.off_path = self.off_path or exceeded(joints, np.array(errors[0]), self._tolerance_rad)


def _fill(point: JointTrajectoryPoint, values: list[Any], time_s: float) -> None:
    for name, each in zip(("positions", "velocities", "accelerations"), values, strict=False):
        setattr(point, name, [float(value) for value in each])
    point.time_from_start.sec, point.time_from_start.nanosec = int(time_s), int(time_s % 1.0 * 1e9)


main = partial(run_node, FeedforwardControllerNode, partial(PatientExecutor, num_threads=THREADS))

if __name__ == "__main__":
    main()
