"""Trials as goals of a stock joint_trajectory_controller."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from concurrent.futures import Future as Made
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any

import numpy as np
from action_msgs.msg import GoalStatus
from builtin_interfaces.msg import Duration, Time
from control_msgs.action import FollowJointTrajectory
from control_msgs.msg import JointTolerance, JointTrajectoryControllerState
from rcl_interfaces.srv import GetParameters
from rclpy.action import ActionClient
from rclpy.action.client import ClientGoalHandle
from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python
from rclpy.serialization import deserialize_message
from rclpy.task import Future
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from tel_ros.core.config import Config
from tel_ros.core.control.observed import ObservedController
from tel_ros.core.control.trajectory_points import TrajectoryPoints
from tel_ros.core.trial import Phase
from tel_ros.core.types import NS_PER_S, FloatArray
from tel_ros.nodes import qos
from tel_ros.nodes.clock import STEADY
from tel_ros.nodes.conversions import time_ns, to_time
from tel_ros.nodes.hot_loop import busy_subscription
from tel_ros.recording import topics

PASSED_EVERY = 8
"""How many states a simulation that waits is told of at once."""
WATCH_PERIOD_S = 0.02
PARAMETERS_TIMEOUT_S = 1.0
LEAD_S = 0.2
"""How long the arm rests at its start after a movement was sent; in lockstep: see there."""
ANSWER_TIMEOUT_S = 0.25
"""Before monitors wonder why the arm does not move. In lockstep it waits: ``sim.lockstep_timeout_s``."""
COMPARED_EVERY_S, OTHER_SHARE, OTHER_TIMES = 0.05, 0.2, 5
"""How often efforts are compared; by which share of the limit they may differ, but for so many times."""
SILENCE_S = 0.5
_ERASED = -1.0


class TrajectoryChannel:
    """Sends the trials of an :class:`ObservedController` to the arm's controller, and watches what it does.

    It stands where a :class:`~tel_ros.nodes.command_channel.CommandChannel` stands: asked to ``send`` with
    every state, it sends a goal when a phase begins that needs one, and cancels it when the trial is being
    stopped. While an answer is under way, a simulation that waits gets no further.
    """

    def __init__(self, node: Node, config: Config) -> None:
        arm, name = config.arm, config.arm.trajectory_controller
        self._node, self._arm, self._name = node, arm, name
        self._tolerance_rad = config.control.path_tolerance_rad
        self._client = ActionClient(node, FollowJointTrajectory, f"{name}/{topics.FOLLOW_JOINT_TRAJECTORY}")
        self.topic = node.resolve_topic_name(f"{name}/{topics.FOLLOW_JOINT_TRAJECTORY}")
        self._parameters = node.create_client(GetParameters, f"{name}/get_parameters")
        state_topic = f"{name}/{topics.CONTROLLER_STATE}"
        self.states = busy_subscription(node, JointTrajectoryControllerState, state_topic, self._on_state)
        """Where the controller says what it does."""
        waits = config.arm_waits_for_commands
        self._patience_s = config.sim.lockstep_timeout_s if waits else ANSWER_TIMEOUT_S
        self._passed = None
        if waits:
            self._passed = node.create_publisher(Time, topics.private(topics.PASSED), qos.EVENTS)
        period_s = 1.0 / (arm.controller_rate_hz or config.control.rate_hz)
        lead_s = (qos.STATES_AHEAD + 1) * period_s if waits else LEAD_S
        # Of a simulation that goes ahead, states come in batches before what was said meanwhile.
        ahead_s = 4 * qos.STATES_AHEAD / config.control.rate_hz if waits else 0.0
        self._silence_s = max(SILENCE_S, ahead_s)
        self._lead_ns = round(lead_s / period_s) * round(period_s * NS_PER_S)
        node.create_timer(WATCH_PERIOD_S, self.follow, clock=STEADY)
        self._controller: ObservedController | None = None
        self._course: object = None
        self._serial = self._sends = 0
        self._last_nm = np.zeros(len(arm.joints))
        # A long movement takes tens of milliseconds: meanwhile states have to be answered.
        self._maker = ThreadPoolExecutor(1)
        self._movement: Made[JointTrajectory] = Made()
        self._handle: ClientGoalHandle | None = None
        self._asked_at = math.inf  # answers that are awaited; inf: none is
        self._stopping = False
        self._stamp_ns = self._told_ns = self._compared_ns = 0
        self._state: bytes | None = None
        self._others = 0
        self._gains_asked_at = -math.inf
        self._gains: str | None = None
        """What is wrong with them; empty: nothing, or nobody knows; None: the controller has not answered."""

    def open(self, controller: ObservedController) -> None:
        """Send the trials of this controller from now on."""
        self._controller, self._course = controller, None

    def shut(self) -> None:
        """Send nothing any more; what is under way is cancelled."""
        self._cancel()
        self._controller = None

    def destroy(self) -> None:
        """Send nothing any more; its endpoints go with the node."""
        self.shut()

    @property
    def listeners(self) -> int:
        """Whether the controller is there."""
        return int(self._client.server_is_ready())

    @property
    def problem(self) -> str:
        """Why no trial can be sent, although the controller is there; empty: one can."""
        if not self.listeners:
            return ""
        if self._gains != "" and time.monotonic() - self._gains_asked_at > PARAMETERS_TIMEOUT_S:
            if self._gains is None and self._gains_asked_at > 0.0:
                self._gains = ""
                self._node.get_logger().warning(
                    f"{self._name} does not tell its parameters: whether its gains are K and B is not known"
                )
                return ""
            self._gains_asked_at = time.monotonic()
            request = GetParameters.Request(names=list(self._expected()))
            self._parameters.call_async(request).add_done_callback(self._compare_gains)
        return f"{self._name} has not told its gains yet" if self._gains is None else self._gains

    def send(self, stamp_ns: int) -> None:
        """Follow the controller to the state with this stamp."""
        self._stamp_ns = stamp_ns
        self.follow()
        self._sends += 1
        if self._sends % PASSED_EVERY == 0:
            self.repeat()

    def repeat(self) -> None:
        """Let a simulation that waits go on, unless an answer is awaited."""
        if self._passed is not None and self._asked_at == math.inf:
            self._passed.publish(to_time(self._stamp_ns))

    def follow(self) -> None:
        """Send, cancel, or find out what is wrong, as the controller's phase demands."""
        controller = self._controller
        if controller is None:
            return
        if time.monotonic() - self._asked_at > self._patience_s:
            self._asked_at, self._stopping = math.inf, False  # a cancellation is asked for again
            silent = f"{self._name} has not answered for {self._patience_s:g} s"
            self._node.get_logger().error(silent)
            controller.abort(silent)
        elif controller.phase is Phase.RUN and self._asked_at < math.inf:
            controller.abort(f"{self._name} has not accepted the movement before its beginning")
        phase = controller.phase
        if phase is Phase.STOP:
            self._cancel()
        elif controller.active and controller.course is not self._course and controller.course.ticks:
            self._course, self._stopping, self._others = controller.course, False, 0
            self._told_ns = self._stamp_ns
            self._send(self._message(controller.approach_points), controller.course.start_ns, _ERASED)
            self._movement = self._maker.submit(
                self._message, partial(controller.movement_points, self._lead_ns)
            )
        elif controller.settled and self._asked_at == math.inf:
            # Time that stands still waits for it: a run does not depend on how long it takes.
            if self._passed is not None or self._movement.done():
                controller.run_from_ns = self._stamp_ns + self._lead_ns
                self._send(self._movement.result(), self._stamp_ns, self._tolerance_rad)
        elif controller.active:
            self._look(controller)

    def _message(self, make: Callable[[], TrajectoryPoints]) -> JointTrajectory:
        return to_joint_trajectory(self._arm.joints, make())

    def _send(self, trajectory: JointTrajectory, start_ns: int, tolerance_rad: float) -> None:
        self._serial += 1
        self._last_nm = np.array(trajectory.points[-1].effort)
        trajectory.header.stamp = to_time(start_ns)
        goal = FollowJointTrajectory.Goal(trajectory=trajectory)
        for joint in self._arm.joints:
            tolerance = JointTolerance(name=joint, position=tolerance_rad, velocity=_ERASED)
            goal.path_tolerance.append(tolerance)
            goal.goal_tolerance.append(tolerance)
        self._asked_at = time.monotonic()
        self._client.send_goal_async(goal).add_done_callback(partial(self._accepted, self._serial))

    def _accepted(self, serial: int, future: Future) -> None:
        handle = future.result()
        self._asked_at = math.inf
        if not handle.accepted:
            if self._controller is not None:
                self._controller.abort(f"{self._name} has rejected the goal; its log says why")
            return
        if serial == self._serial:
            self._handle = handle
        handle.get_result_async().add_done_callback(partial(self._ended, serial))
        if self._stopping or self._controller is None:
            self._stopping = False
            self._cancel()
        self.repeat()

    def _ended(self, serial: int, future: Future) -> None:
        if serial != self._serial:
            return  # another one has taken its place
        ended, controller, self._handle = future.result(), self._controller, None
        result = ended.result
        if controller is None or ended.status == GoalStatus.STATUS_SUCCEEDED:
            if controller is not None:
                controller.reached_nm = self._last_nm
            return
        if ended.status == GoalStatus.STATUS_CANCELED:
            controller.abort(f"{self._name}: the goal was cancelled by somebody else")
        else:
            controller.abort(f"{self._name}: {result.error_string} (error {result.error_code})")

    def _cancel(self) -> None:
        """Cancel the goal that is under way, or will be once it is accepted."""
        if self._stopping:
            return
        self._stopping = True
        if self._handle is not None and self.listeners:
            self._asked_at = time.monotonic()
            self._handle.cancel_goal_async().add_done_callback(self._cancelled)

    def _cancelled(self, future: Future) -> None:
        self._asked_at = math.inf
        self.repeat()

    # What the controller does.

    def _on_state(self, raw: bytes) -> None:
        self._state = raw

    def _look(self, controller: ObservedController) -> None:
        """Compare what is commanded with what should be, a few times a second."""
        if 0 < self._stamp_ns - self._compared_ns < COMPARED_EVERY_S * NS_PER_S:
            return
        self._compared_ns = self._stamp_ns
        raw, self._state = self._state, None
        if raw is None:
            silent_s = (self._stamp_ns - self._told_ns) / NS_PER_S
            if silent_s > self._silence_s:
                what = f"{self._name} has said nothing on its {topics.CONTROLLER_STATE}"
                controller.abort(f"{what} for {silent_s:.2f} s")
            return
        said = deserialize_message(raw, JointTrajectoryControllerState)
        self._told_ns = self._stamp_ns
        found = self._differs(said, controller)
        if found is not None:
            self._others = self._others + 1 if found else 0
        if self._others >= OTHER_TIMES:
            controller.abort(found or "")

    def _differs(self, said: Any, controller: ObservedController) -> str | None:
        """Say how its command differs from ours; empty: it does not; None: ours is not known."""
        if set(said.joint_names) != set(self._arm.joints) or len(said.output.effort) != len(said.joint_names):
            return f"{self._name} commands no efforts of {', '.join(self._arm.joints)}"
        order = [list(said.joint_names).index(joint) for joint in self._arm.joints]
        commanded = np.array(said.output.effort)[order]
        expected = controller.effort_at(time_ns(said.header.stamp))
        if expected is None:
            return None
        limit = np.array(self._arm.effort_limit_nm)
        off = np.abs(commanded.clip(-limit, limit) - expected)
        j = int(np.argmax(off / limit))
        if off[j] <= OTHER_SHARE * limit[j]:
            return ""
        return (
            f"{self._name} commands {commanded[j]:.2f} N·m at {self._arm.joints[j]}, and K and B make "
            f"{expected[j]:.2f}: its gains or its trajectory are not those of this run"
        )

    def _expected(self) -> dict[str, object]:
        """Return the parameters that make the controller's law that of practice."""
        arm = self._arm
        values: dict[str, object] = {"command_interfaces": ["effort"]}
        rows = zip(arm.joints, arm.stiffness_nm_per_rad, arm.damping_nms_per_rad, strict=True)
        for joint, stiffness, damping in rows:
            gains = {"p": stiffness, "i": 0.0, "d": damping, "ff_velocity_scale": 0.0}
            values |= {f"gains.{joint}.{name}": value for name, value in gains.items()}
        return values

    def _compare_gains(self, future: Future) -> None:
        found = [parameter_value_to_python(value) for value in future.result().values]
        expected = self._expected()
        if len(found) != len(expected):
            return  # it has not all of them: that is no answer
        self._gains = ""
        for (name, wanted), value in zip(expected.items(), found, strict=True):
            equal = value == wanted if isinstance(wanted, list) else _close(value, wanted)
            if not equal:
                self._gains = f"{self._name}: {name} is {value}; expected {wanted}, as the arm is configured"
                return


def _close(value: object, wanted: object) -> bool:
    both = isinstance(value, float) and isinstance(wanted, float)
    return both and math.isclose(value, wanted, rel_tol=1e-6)  # type: ignore[arg-type]


def to_joint_trajectory(joints: tuple[str, ...], points: TrajectoryPoints) -> JointTrajectory:
    """Return a message that does not say when it begins."""
    trajectory = JointTrajectory(joint_names=list(joints))
    arrays: list[FloatArray] = [
        points.position_rad,
        points.velocity_rad_s,
        points.acceleration_rad_s2,
        points.effort_nm,
    ]
    for at_ns, *rows in zip(points.time_ns.tolist(), *(array.tolist() for array in arrays), strict=True):
        point = JointTrajectoryPoint()
        point.positions, point.velocities, point.accelerations, point.effort = rows
        seconds, nanoseconds = divmod(at_ns, NS_PER_S)
        point.time_from_start = Duration(sec=seconds, nanosec=nanoseconds)
        trajectory.points.append(point)
    return trajectory
