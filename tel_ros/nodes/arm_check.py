"""Listening to an arm, and pulsing it: the client of ``tel check``."""

from __future__ import annotations

import math
import time
from bisect import bisect_left
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from functools import partial

import numpy as np
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.topic_endpoint_info import TopicEndpointInfo
from sensor_msgs.msg import JointState

from tel_ros.core.check.evidence import Endpoint, Heard, StateRecord
from tel_ros.core.check.pulses import Course
from tel_ros.core.safety.layer import SafetyLayer
from tel_ros.core.types import NS_PER_S, FloatArray
from tel_ros.nodes.command_channel import CommandChannel, CompetingPublishers
from tel_ros.nodes.conversions import time_ns
from tel_ros.nodes.hot_loop import BusyGroup, spin_hot
from tel_ros.nodes.runner import start_ros
from tel_ros.recording import topics

HEAR_ALL = QoSProfile(reliability=ReliabilityPolicy.BEST_EFFORT, history=HistoryPolicy.KEEP_LAST, depth=1000)
"""For a check: every state counts, and a publisher that offers best effort only is to be heard, too."""
LOOK_PERIOD_S = 0.1


class ArmClient(AbstractContextManager["ArmClient"]):
    """Hears all joint states; commands efforts only while :meth:`run` runs. Use it with ``with``.

    There is no publisher of commands before the first :meth:`open_channel`: who only listens cannot command.
    """

    def __init__(self, joints: Sequence[str], namespace: str = "/") -> None:
        self._joints = tuple(joints)
        self.still_there: Callable[[], None] = lambda: None
        """Called in every turn; raises if it makes no sense to go on."""
        self._rows: list[Heard] = []
        self._course: Course | None = None
        self._channel: tuple[CommandChannel, SafetyLayer] | None = None
        self._rivals: CompetingPublishers | None = None
        self._look_s = 0.0
        self.names: set[tuple[str, ...]] = set()
        """Lists of names that have come."""
        self.malformed = 0
        """Messages whose fields do not fit together."""
        start_ros()
        self.node = Node("tel_check", namespace=namespace)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)
        self._subscription = self.node.create_subscription(
            JointState, topics.JOINT_STATES, self._on_state, HEAR_ALL, callback_group=BusyGroup()
        )

    def __exit__(self, *_: object) -> None:
        """Command zero effort, if the channel is open, and shut down."""
        try:
            self.send_zero()
        finally:
            self._executor.shutdown(timeout_sec=1.0)
            self.node.destroy_node()
            rclpy.try_shutdown()

    def forget(self) -> None:
        """Drop the states that have arrived so far."""
        self._rows.clear()

    def states(self, since_s: float = -math.inf) -> StateRecord:
        """Return the states that have arrived since a time and name all joints."""
        begin = bisect_left(self._rows, since_s, key=lambda row: row.received_s)
        return StateRecord.of(self._joints, self._rows[begin:])

    @property
    def newest(self) -> Heard:
        """The newest state; there has to be one."""
        return self._rows[-1]

    def spin_for(self, duration_s: float) -> None:
        """Listen for a while."""
        self.spin_until(lambda: False, duration_s)

    def spin_until(self, done: Callable[[], bool], timeout_s: float) -> bool:
        """Listen until a condition holds; return whether it did in time."""
        end = time.monotonic() + timeout_s
        came = False

        def over() -> bool:
            nonlocal came
            self.still_there()
            came = done()
            return came or time.monotonic() > end

        spin_hot(self.node, self._executor, [self._subscription], over)
        return came

    def open_channel(self, layer: SafetyLayer, timeout_s: float) -> bool:
        """Make a publisher of commands, all through this layer; return whether somebody listens in time."""
        channel = CommandChannel(self.node, "effort")
        channel.open(layer)
        self._channel = channel, layer
        self._rivals = CompetingPublishers(self.node, channel.topic)
        return self.spin_until(lambda: channel.listeners > 0, timeout_s)

    def run(self, course: Course) -> None:
        """Answer each state at once; zero effort is commanded at the end in any case, as in silence."""
        self._course = course
        try:
            self.spin_until(partial(self._watched, course), math.inf)
        finally:
            self.send_zero()

    def send_zero(self) -> None:
        """Command zero effort a few times, if a channel is open."""
        self._course = None
        if self._channel is None:
            return
        for _ in range(5):
            self._send(np.zeros(len(self._joints)))
            time.sleep(0.004)

    def _watched(self, course: Course) -> bool:
        now_s = time.monotonic()
        if self._rivals is not None and now_s > self._look_s:
            self._look_s = now_s + LOOK_PERIOD_S
            self._rivals.look()
            if others := self._rivals.of_commands or self._rivals.of_states:
                course.guard.stop(others, "end all but the arm's own driver and this check")
        self._send(course.watch(now_s))
        return course.done

    def _on_state(self, message: JointState) -> None:
        now_s, names = time.monotonic(), tuple(message.name)
        self.names.add(names)
        missing = [joint for joint in self._joints if joint not in names]
        if missing or len(message.position) != len(names):
            self.malformed += not missing
            if self._course is not None:
                lack = f"{', '.join(missing)} is missing" if missing else ""
                self._course.guard.ignored(lack or "names and positions do not fit together")
            return
        columns = [names.index(joint) for joint in self._joints]
        stamp_ns = time_ns(message.header.stamp)
        velocity = self._field(message.velocity, names, columns)
        effort = self._field(message.effort, names, columns)
        age_s = (time.time_ns() - stamp_ns) / NS_PER_S
        heard = Heard(now_s, stamp_ns, age_s, np.array(message.position)[columns], velocity, effort)
        self._rows.append(heard)
        if self._course is not None and not self._course.done:
            self._send(self._course.step(heard))

    def _field(self, values: Sequence[float], names: Sequence[str], columns: list[int]) -> FloatArray:
        """Return a field that may be missing, in the order of the joints; NaN where it is."""
        if len(values) == len(names):
            return np.array(values)[columns]
        self.malformed += len(values) > 0
        return np.full(len(columns), math.nan)

    def _send(self, effort_nm: FloatArray | None) -> None:
        if effort_nm is None or self._channel is None:
            return
        channel, layer = self._channel
        layer.permit_pulse(effort_nm)
        channel.send(self._rows[-1].stamp_ns if self._rows else 0)


def endpoints(node: Node, command_topic: str) -> tuple[list[Endpoint], list[Endpoint], list[Endpoint]]:
    """Return who else publishes joint states, publishes commands and subscribes to commands."""
    own = (node.get_name(), node.get_namespace())

    def others(infos: list[TopicEndpointInfo]) -> list[Endpoint]:
        return sorted(
            (info.node_name, info.topic_type, info.qos_profile.reliability.name.lower())
            for info in infos
            if (info.node_name, info.node_namespace) != own
        )

    return (
        others(node.get_publishers_info_by_topic(topics.JOINT_STATES)),
        others(node.get_publishers_info_by_topic(command_topic)),
        others(node.get_subscriptions_info_by_topic(command_topic)),
    )
