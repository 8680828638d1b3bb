"""What the live view hears from the graph, and the services that its buttons call."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from action_msgs.srv import CancelGoal
from rclpy.client import Client
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool
from std_srvs.srv import SetBool, Trigger
from tel_interfaces.action import Practice
from tel_interfaces.msg import ControlState, TrialGoal

from tel_ros.core.arm_state import ArmState
from tel_ros.core.config import Config
from tel_ros.core.errors import StateError
from tel_ros.core.safety.gate import StateGate
from tel_ros.nodes import qos
from tel_ros.nodes.conversions import joint_state_numbers
from tel_ros.nodes.hot_loop import BusyGroup, serves_itself, take
from tel_ros.recording import topics

ANSWER_TIMEOUT_S = 2.0


class GraphView:
    """Subscribes best effort, and takes only the newest message of the fast topics, when it looks.

    It has no publisher. Its services can be called from any thread, and return at once.
    """

    def __init__(
        self,
        node: Node,
        config: Config,
        on_goal: Callable[[TrialGoal], None],
        on_feedback: Callable[[Practice.Feedback], None],
    ) -> None:
        self._node = node
        self._n_joints = len(config.arm.joints)
        self._gate = StateGate(config.arm, config.control)
        self.arm: ArmState | None = None
        """The newest state of the arm."""
        self.sample: ControlState | None = None
        """The newest state of the controller."""
        self.stopped = self.paused = False
        self.answer, self.alarm = "", False
        """The last answer of a service, and whether it is bad news."""
        self._arm_at = -np.inf
        self._asked: list[tuple[str, bool, float, Any]] = []
        self._arm_states, self._control_states = (
            node.create_subscription(kind, topic, heard, qos.NEWEST, callback_group=BusyGroup())
            for kind, topic, heard in (
                (JointState, topics.JOINT_STATES, self._on_joint_state),
                (ControlState, topics.CONTROL_STATES, self._on_control_state),
            )
        )
        node.create_subscription(TrialGoal, topics.TRIAL_GOAL, on_goal, qos.LATCHED)
        for topic, name in ((topics.SAFETY_STOPPED, "stopped"), (topics.PAUSED, "paused")):
            heard = partial(lambda name, message: setattr(self, name, message.data), name)
            node.create_subscription(Bool, topic, heard, qos.LATCHED)
        # The feedback of an action is a topic like any other.
        kind, topic = Practice.Impl.FeedbackMessage, f"{topics.PRACTICE}/_action/feedback"
        hear: Callable[[Any], None] = lambda message: on_feedback(message.feedback)  # noqa: E731
        node.create_subscription(kind, topic, hear, qos.EVENTS)
        self._stop = node.create_client(Trigger, topics.SAFETY_STOP)
        self._reset = node.create_client(Trigger, topics.SAFETY_RESET)
        self._pause = node.create_client(SetBool, topics.PAUSE)
        self._cancel = node.create_client(CancelGoal, f"{topics.PRACTICE}/_action/cancel_goal")

    @property
    def arm_age_s(self) -> float:
        """How long ago the last joint state was heard; inf: none was."""
        return time.monotonic() - self._arm_at

    def look_at_arm(self) -> None:
        """Take the newest state of the arm, and see whether what was asked has been answered."""
        if serves_itself():  # else the executor does it
            take(self._arm_states)
        for asked in list(self._asked):
            what, urgent, at, future = asked
            good, text = False, f"NO ANSWER for {ANSWER_TIMEOUT_S:.0f} s"
            if future.done():
                good, text = _said(future.result())
            elif time.monotonic() - at <= ANSWER_TIMEOUT_S:
                continue
            self._asked.remove(asked)
            self._say(f"{what}: {text}", urgent, bad=not good)

    def look_at_controller(self) -> None:
        """Take the newest state of the controller."""
        if serves_itself():
            take(self._control_states)

    def emergency_stop(self) -> None:
        """Ask for the emergency stop in software."""
        self._ask(self._stop, Trigger.Request(), "emergency stop", urgent=True)

    def reset(self) -> None:
        """Ask for its reset."""
        self._ask(self._reset, Trigger.Request(), "reset")

    def end_run(self) -> None:
        """Ask for the end of the practice run: the arm is brought to rest first."""
        # No id and no time: whatever run there is.
        self._ask(self._cancel, CancelGoal.Request(), "stop", urgent=True)

    def pause(self, paused: bool) -> None:
        """Ask for a pause after the trial under way, or for its end."""
        self._ask(self._pause, SetBool.Request(data=paused), "pause" if paused else "go on")

    def _ask(self, client: Client, request: Any, what: str, urgent: bool = False) -> None:
        if client.service_is_ready():
            self._asked.append((what, urgent, time.monotonic(), client.call_async(request)))
        else:
            self._say(f"{what}: nobody offers {client.service_name}", urgent, bad=True)

    def _say(self, text: str, urgent: bool, bad: bool) -> None:
        self.answer, self.alarm = f"{text}; use the emergency stop by wire" if urgent and bad else text, bad

    def _on_joint_state(self, message: JointState) -> None:
        try:
            self.arm = self._gate.admit(*joint_state_numbers(message), time.monotonic_ns())
        except StateError as error:
            self.answer, self.alarm = str(error), True
            return
        self._arm_at = time.monotonic()

    def _on_control_state(self, message: ControlState) -> None:
        if len(message.position_rad) == self._n_joints:  # else another arm's
            self.sample = message


def _said(response: Any) -> tuple[bool, str]:
    if isinstance(response, CancelGoal.Response):
        cancelled = len(response.goals_canceling)
        return cancelled > 0, "the run is ending" if cancelled else "no run is under way"
    return response.success, response.message or "done"
