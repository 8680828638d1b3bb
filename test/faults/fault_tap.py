"""Between the arm and the graph, or beside them: hears what the arm really does, and disturbs what passes."""

from __future__ import annotations

import heapq
import itertools
import threading
import time
from array import array
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np
from fault_judge import Control, Trace
from fault_messages import Corruption, Message
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Trigger
from tel_interfaces.msg import ControlState

from tel_ros.core.types import NS_PER_S
from tel_ros.nodes import qos
from tel_ros.nodes.conversions import to_time
from tel_ros.nodes.hot_loop import BusyGroup, spin_hot
from tel_ros.nodes.realtime import set_priority
from tel_ros.recording import topics
from tel_ros.recording.cdr import header_stamp_ns, trial_index

ARM_STATES = "/arm/joint_states"
ARM_COMMANDS = "/arm/commands"
REMAPPED = ("-r", f"{topics.JOINT_STATES}:={ARM_STATES}", "-r", f"{topics.EFFORT_COMMANDS}:={ARM_COMMANDS}")
"""Arguments that put the simulated arm's topics behind the tap."""


@dataclass
class Channel:
    """One direction of what passes."""

    kind: type
    out: Publisher | None
    corruption: Corruption | None = None
    until_ns: int = 0
    late: list[tuple[int, int, Message]] = field(default_factory=list)
    """Heap of messages on their way: arm time at which they are due, number, message."""


@dataclass(frozen=True)
class Heard:
    """One message as it came: when (wall clock; stamp of the arm's newest state), and its bytes."""

    wall_s: float
    arm_ns: int
    raw: bytes


class Tap(Node):
    """Hears states, commands and control states; where it stands in between, it passes them on."""

    def __init__(self, context: Context, in_between: bool) -> None:
        super().__init__("observer", context=context)
        self._in_between = in_between
        self.states: list[Heard] = []
        self.commands: list[Heard] = []
        self.controls: list[Heard] = []
        self.begun: dict[int, Heard] = {}
        """First control state of each trial."""
        self.arm_ns = 0
        self._numbers = itertools.count()
        self._due: tuple[int, float, Callable[[int], None]] | None = None
        self._foreign: tuple[Publisher, Callable[[], Message], int] | None = None
        self.foreign_since_ns: int | None = None
        self._stop = self.create_client(Trigger, topics.SAFETY_STOP)
        group = BusyGroup()
        to_graph = self.create_publisher(JointState, topics.JOINT_STATES, qos.STREAM) if in_between else None
        to_arm = self.create_publisher(Float64MultiArray, ARM_COMMANDS, qos.STREAM) if in_between else None
        self.channels = {
            "states": Channel(JointState, to_graph),
            "commands": Channel(Float64MultiArray, to_arm),
        }
        listened = (
            (JointState, ARM_STATES if in_between else topics.JOINT_STATES, self._on_state),
            (Float64MultiArray, topics.EFFORT_COMMANDS, self._on_command),
            (ControlState, topics.CONTROL_STATES, self._on_control),
        )
        self.busy_subscriptions = [
            self.create_subscription(kind, topic, on_message, qos.EVERYTHING, raw=True, callback_group=group)
            for kind, topic, on_message in listened
        ]

    def when(self, trial: int, offset_s: float, act: Callable[[int], None]) -> threading.Event:
        """Act once, in this node's thread, a time of the arm after the first tick of that or a later trial.

        The event is set when it has been done.
        """
        done = threading.Event()

        def act_and_say(index: int) -> None:
            act(index)
            done.set()

        self._due = (trial, offset_s, act_and_say)
        return done

    def corrupt(self, channel: str, corruption: Corruption, duration_s: float) -> None:
        """Disturb what passes on a channel for a time of the arm."""
        self.channels[channel].corruption = corruption
        self.channels[channel].until_ns = self.arm_ns + round(duration_s * NS_PER_S)

    def intrude(self, channel: str, make: Callable[[], Message], duration_s: float) -> None:
        """Open a second publisher, of states to the graph or of commands to the arm, and use it a while."""
        topic = topics.JOINT_STATES if channel == "states" else topics.EFFORT_COMMANDS
        publisher = self.create_publisher(self.channels[channel].kind, topic, qos.STREAM)
        self._foreign = (publisher, make, self.arm_ns + round(duration_s * NS_PER_S))
        self.foreign_since_ns = None

    def resting_state(self, joints: tuple[str, ...]) -> JointState:
        """Return what a second driver might say: all joints at zero, now."""
        zero = array("d", [0.0] * len(joints))
        message = JointState(name=list(joints), position=zero, velocity=zero, effort=zero)
        message.header.stamp = to_time(self.arm_ns)
        return message

    def emergency_stop(self) -> None:
        self._stop.call_async(Trigger.Request())

    def trace(self, since_wall_s: float) -> Trace:
        """Return what the arm did and the controller said since a moment of the wall clock."""
        states = {}
        for heard in [h for h in self.states if h.wall_s >= since_wall_s]:
            states.setdefault(heard.arm_ns, heard.raw)  # an arm in lockstep repeats its state
        messages = [deserialize_message(raw, JointState) for raw in states.values()]
        controls = []
        for heard in [h for h in self.controls if h.wall_s >= since_wall_s]:
            said = deserialize_message(heard.raw, ControlState)
            controls.append(Control(self._said_ns(heard), int(said.trial), int(said.phase)))
        return Trace(
            time_ns=np.array(list(states), dtype=np.int64),
            position_rad=np.array([message.position for message in messages]),
            velocity_rad_s=np.array([message.velocity for message in messages]),
            effort_nm=np.array([message.effort for message in messages]),
            controls=controls,
        )

    def _said_ns(self, heard: Heard) -> int:
        """Return the arm time at which the controller said something.

        In lockstep that is the state that it answers. By the time of hearing it would be wrong by as much as
        the queue of the states is longer or shorter than that of the control states, which is half a second
        of a fast arm on a busy machine. In between, the stamps that the controller got may be wrong on
        purpose; there the arm keeps the pace of the wall clock.
        """
        return heard.arm_ns if self._in_between else header_stamp_ns(heard.raw)

    def _on_state(self, raw: bytes) -> None:
        self.arm_ns = header_stamp_ns(raw)
        self.states.append(Heard(time.monotonic(), self.arm_ns, raw))
        self._act_if_due()
        self._pass("states", raw)
        self._send_late("states")
        self._send_late("commands")
        self._send_foreign()

    def _on_command(self, raw: bytes) -> None:
        self.commands.append(Heard(time.monotonic(), self.arm_ns, raw))
        self._pass("commands", raw)

    def _on_control(self, raw: bytes) -> None:
        heard = Heard(time.monotonic(), self.arm_ns, raw)
        self.controls.append(heard)
        index = trial_index(raw)
        if index and index not in self.begun:
            self.begun[index] = heard

    def _act_if_due(self) -> None:
        if self._due is None:
            return
        trial, offset_s, act = self._due
        newest = max(self.begun, default=0)
        if newest >= trial and self.arm_ns - self.begun[newest].arm_ns >= offset_s * NS_PER_S:
            self._due = None
            act(newest)

    def _pass(self, name: str, raw: bytes) -> None:
        channel = self.channels[name]
        if channel.out is None:
            return
        if channel.corruption is None:
            channel.out.publish(raw)
            return
        if self.arm_ns >= channel.until_ns:
            # What is still on its way comes now, in its order, before what is not late.
            channel.corruption = None
            for _, _, message in sorted(channel.late):
                channel.out.publish(message)
            channel.late.clear()
            channel.out.publish(raw)
            return
        for delay_s, message in channel.corruption(deserialize_message(raw, channel.kind)):
            if delay_s:
                due_ns = self.arm_ns + round(delay_s * NS_PER_S)
                heapq.heappush(channel.late, (due_ns, next(self._numbers), message))
            else:
                channel.out.publish(message)

    def _send_late(self, name: str) -> None:
        channel = self.channels[name]
        while channel.late and channel.late[0][0] <= self.arm_ns:
            channel.out.publish(heapq.heappop(channel.late)[2])

    def _send_foreign(self) -> None:
        if self._foreign is None:
            return
        publisher, make, until_ns = self._foreign
        if self.arm_ns >= until_ns:
            self._foreign = None
            self.destroy_publisher(publisher)
        elif publisher.get_subscription_count():
            self.foreign_since_ns = self.foreign_since_ns or self.arm_ns
            publisher.publish(make())


@contextmanager
def spun_tap(domain: int, in_between: bool, priority: int = 0) -> Iterator[Tap]:
    """Spin a tap in a thread of its own, with a SCHED_FIFO priority where it is permitted; 0: none."""
    context = Context()
    context.init(domain_id=domain)
    tap, ended = Tap(context, in_between), threading.Event()
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(tap)

    def spin() -> None:
        # Not the main thread: it judges, and would keep a core from everybody for so long.
        set_priority(priority, but=[threading.main_thread().native_id or 0])
        spin_hot(tap, executor, tap.busy_subscriptions, ended.is_set)

    thread = threading.Thread(target=spin)
    thread.start()
    try:
        yield tap
    finally:
        ended.set()
        thread.join()
        executor.shutdown()
        tap.destroy_node()
        context.try_shutdown()
