"""Listening to an arm, and pulsing it: the client of ``tel check``."""

from __future__ import annotations

import math
import time
from bisect import bisect_left
from collections.abc import Callable, Iterable, Sequence
from contextlib import AbstractContextManager
from functools import partial

import numpy as np
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.topic_endpoint_info import TopicEndpointInfo
from sensor_msgs.msg import JointState

from tel_ros.core.check.evidence import Endpoint, StateRecord
from tel_ros.core.check.pulses import Program
from tel_ros.core.safety.layer import SafetyLayer
from tel_ros.core.types import NS_PER_S, FloatArray
from tel_ros.nodes.command_channel import CommandChannel
from tel_ros.nodes.conversions import time_ns
from tel_ros.nodes.hot_loop import BusyGroup, spin_hot
from tel_ros.nodes.runner import start_ros
from tel_ros.recording import topics

HEAR_ALL = QoSProfile(reliability=ReliabilityPolicy.BEST_EFFORT, history=HistoryPolicy.KEEP_LAST, depth=1000)
"""For a check: every state counts, and a publisher that offers best effort only is to be heard, too."""
Row = tuple[float, int, float, FloatArray, FloatArray, FloatArray]


class ArmClient(AbstractContextManager["ArmClient"]):
    """Hears all joint states; commands efforts only while :meth:`run` runs. Use it with ``with``.

    There is no publisher of commands before the first :meth:`open_channel`: who only listens cannot command.
    ``still_there`` is called in every turn and raises if it makes no sense to go on.
    """

    def __init__(
        self, joints: Sequence[str], still_there: Callable[[], None] = lambda: None, namespace: str = "/"
    ) -> None:
        self._joints, self._still_there = tuple(joints), still_there
        self._rows: list[Row] = []
        self._program: Program | None = None
        self._channel: tuple[CommandChannel, SafetyLayer] | None = None
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
        rows = self._rows[bisect_left(self._rows, since_s, key=lambda row: row[0]) :]
        n = (len(rows), len(self._joints))
        columns = list(zip(*rows, strict=True)) or [()] * 6
        received, stamps, ages, *fields = columns
        return StateRecord(
            self._joints,
            np.array(received, dtype=np.float64),
            np.array(stamps, dtype=np.int64),
            np.array(ages, dtype=np.float64),
            *(np.array(field, dtype=np.float64).reshape(n) for field in fields),
        )

    def spin_for(self, duration_s: float) -> None:
        """Listen for a while."""
        self.spin_until(lambda: False, duration_s)

    def spin_until(self, done: Callable[[], bool], timeout_s: float) -> bool:
        """Listen until a condition holds; return whether it did in time."""
        end = time.monotonic() + timeout_s
        came = False

        def over() -> bool:
            nonlocal came
            self._still_there()
            came = done()
            return came or time.monotonic() > end

        spin_hot(self.node, self._executor, [self._subscription], over)
        return came

    def open_channel(self, layer: SafetyLayer, timeout_s: float) -> bool:
        """Make a publisher of commands, all through this layer; return whether somebody listens in time."""
        channel = CommandChannel(self.node, "effort")
        channel.open(layer)
        self._channel = channel, layer
        return self.spin_until(lambda: channel.listeners > 0, timeout_s)

    def run(self, programs: Iterable[Program]) -> None:
        """Run programs one after the other; zero effort is commanded at the end in any case.

        Each state is answered at once. When none comes for a while the program itself ends with zero effort.
        """
        try:
            for program in programs:
                self._program = program
                self.spin_until(partial(self._watched, program), math.inf)
        finally:
            self.send_zero()

    def send_zero(self) -> None:
        """Command zero effort a few times, if a channel is open."""
        self._program = None
        if self._channel is None:
            return
        for _ in range(5):
            self._send(np.zeros(len(self._joints)))
            time.sleep(0.004)

    def _watched(self, program: Program) -> bool:
        self._send(program.watch(time.monotonic()))
        return program.done

    def _on_state(self, message: JointState) -> None:
        now_s, names = time.monotonic(), tuple(message.name)
        self.names.add(names)
        if set(self._joints) - set(names):
            return
        if len(message.position) != len(names):
            self.malformed += 1
            return
        columns = [names.index(joint) for joint in self._joints]
        stamp_ns = time_ns(message.header.stamp)
        position = np.array(message.position)[columns]
        age_s = (time.time_ns() - stamp_ns) / NS_PER_S
        velocity = self._field(message.velocity, names, columns)
        effort = self._field(message.effort, names, columns)
        self._rows.append((now_s, stamp_ns, age_s, position, velocity, effort))
        if self._program is not None and not self._program.done:
            self._send(self._program.step(now_s, position))

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
        channel.send(self._rows[-1][1] if self._rows else 0)  # the stamp of the newest state


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
