"""Publishing a bag at its pace: the graph's side of ``tel replay``."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from importlib import import_module
from typing import Any

import rclpy
from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile
from rosgraph_msgs.msg import Clock
from std_srvs.srv import SetBool

from tel_ros.core.errors import TelError
from tel_ros.nodes import qos
from tel_ros.nodes.conversions import to_time
from tel_ros.nodes.runner import start_ros
from tel_ros.recording import topics
from tel_ros.recording.replay import PREFIX, Replay, ReplayedTopic, ReplaySchedule

PAUSE = f"{PREFIX}/pause"
"""std_srvs/SetBool: true stops the time of the replay, false lets it go on."""
DISCOVERY_S = 1.0
LONG_DISCOVERY_S = 3.0
"""After an unclean end of another node discovery takes nearly this long."""
_LOOK_PERIOD_S = 0.05
_CLOCK_PERIOD_S = 0.01
_LAST_WORDS_S = 2.0
_MOST_LATCHED = 1000
_HARMLESS_LISTENERS = frozenset({"trial_recorder", topics.ARM_GUARD})
"""Nodes of ours that hear commands and do not move an arm."""


class ReplayRefusedError(TelError):
    """The replay could move an arm, or another node publishes the same topics."""


class BagPlayer:
    """Publishes the topics of a replay. Use it with ``with``.

    Everything goes to names below ``/replay``, apart from the joint states that the nodes are to hear. A
    controller takes those for an arm's and may command efforts that fit the recorded motion. So the replay is
    refused, or ends, as soon as anybody listens to commands or another node publishes joint states.
    ``with_clock``: whether to publish ``/clock`` as well. ``toggled``: polled; true: the user wants a pause,
    or its end. ``on_pause``: called with true when a pause begins, with false when it ends. ``namespace``: of
    the nodes that are to hear the joint states.
    """

    def __init__(
        self,
        replay: Replay,
        *,
        with_clock: bool = True,
        toggled: Callable[[], bool] = lambda: False,
        on_pause: Callable[[bool], None] = lambda paused: None,
        namespace: str = "/",
    ) -> None:
        self._replay, self._toggled, self._said_pause = replay, toggled, on_pause
        self.skipped: list[str] = []
        """Why some topics are not published, a line each."""
        self.published = 0
        """Messages so far, without those of the clock."""
        self.stood_still_s = self.most_late_s = 0.0
        """Of all passes, see :class:`ReplaySchedule`."""
        self._schedule: ReplaySchedule | None = None
        self._next_look_s = 0.0
        self._clock: Publisher | None = None
        self._clock_ns = -1
        self._next_clock_s = 0.0
        self._publishers: dict[str, Publisher] = {}
        self._feeds_nodes = any(topic.name == topics.JOINT_STATES for topic in replay.topics)
        start_ros()
        # Two replays may run side by side.
        self.node = Node(f"bag_player_{os.getpid()}", namespace=namespace)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)
        try:
            self._watch_for(LONG_DISCOVERY_S if self._feeds_nodes else 0.0, with_clock)
            self.played: Sequence[ReplayedTopic] = [topic for topic in replay.topics if self._made(topic)]
            if with_clock:
                self._clock = self.node.create_publisher(Clock, topics.CLOCK, qos.STREAM)
            self.node.create_service(SetBool, PAUSE, self._on_pause)
            # Subscribers need time to find the publishers.
            self._watch_for(DISCOVERY_S, with_clock)
        except BaseException:
            self._end()
            raise

    def __enter__(self) -> BagPlayer:
        """Return the player."""
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        """Wait until what was published has arrived, unless something went wrong, and end."""
        if kind is None:
            end = time.monotonic() + _LAST_WORDS_S
            for publisher in self._publishers.values():
                publisher.wait_for_all_acked(Duration(seconds=max(0.0, end - time.monotonic())))
        self._end()

    def play(self, rate: float) -> None:
        """Publish all once, ``rate`` s of the bag in one; ReplayRefusedError: an arm has come; BagError."""
        schedule = self._schedule = ReplaySchedule(rate, self._replay.start_ns, time.monotonic())
        self._clock_ns = -1
        try:
            for topic, time_ns, raw in self._replay.messages(self.played) if self.played else ():
                self._wait_until(time_ns)
                schedule.late(time_ns, time.monotonic())
                self._tell_time(time_ns)
                self._publishers[topic.name].publish(raw)
                self.published += 1
            self._wait_until(self._replay.end_ns)
        finally:
            self.stood_still_s += schedule.stood_still_s
            self.most_late_s = max(self.most_late_s, schedule.most_late_s)

    def _made(self, topic: ReplayedTopic) -> bool:
        """Make the publisher of a topic, or note why it is left out."""
        if why_not := self._make(topic):
            self.skipped.append(f"{topic.connection.topic} is left out: {why_not}")
        return not why_not

    def _make(self, topic: ReplayedTopic) -> str:
        kind, name = topic.connection.msgtype, topic.name
        if name in self._publishers:
            return "the bag has two topics of that name"
        # Whatever else changes: commands reach an arm through the command channel alone.
        if name != topics.JOINT_STATES and not name.startswith(f"{PREFIX}/"):
            raise ReplayRefusedError(f"{name} is no name for a replay; expected one below {PREFIX}")
        if (message := message_class(kind)) is None:
            return f"there is no {kind} here"
        latched = QoSProfile(
            depth=min(max(1, topic.connection.msgcount), _MOST_LATCHED),
            durability=DurabilityPolicy.TRANSIENT_LOCAL,
        )
        try:
            publisher = self.node.create_publisher(message, name, latched if topic.latched else qos.STREAM)
        except Exception as error:  # type support that is broken or missing, and names that ROS 2 forbids
            return " ".join(str(error).split())
        infos, own = self.node.get_publishers_info_by_topic(name), self.node.get_name()
        here = next((str(info.topic_type_hash) for info in infos if info.node_name == own), "")
        if topic.type_hash and here and here != topic.type_hash:
            self.node.destroy_publisher(publisher)
            return f"{kind} was defined differently when it was recorded"
        self._publishers[name] = publisher
        return ""

    def _on_pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        if self._schedule is None:
            response.message = "the replay has not begun"
            return response
        self._set_pause(request.data)
        response.success = True
        response.message = "paused" if request.data else "goes on"
        return response

    def _watch_for(self, duration_s: float, with_clock: bool) -> None:
        """Watch the graph for a while."""
        end = time.monotonic() + duration_s
        while time.monotonic() < end:
            time.sleep(_LOOK_PERIOD_S)
            self._refuse_if_in_danger(with_clock)

    def _wait_until(self, time_ns: int) -> None:
        """Wait until a time in the bag is due; meanwhile watch the graph and publish the clock."""
        schedule = self._schedule
        while True:
            now_s = time.monotonic()
            if now_s >= self._next_look_s:
                self._look()
                self._next_look_s = now_s + _LOOK_PERIOD_S
                now_s = time.monotonic()
            if schedule.paused:
                time.sleep(_LOOK_PERIOD_S)
                continue
            wait_s = schedule.due_s(time_ns) - now_s
            if wait_s <= 0.0:
                return
            if now_s >= self._next_clock_s:
                self._tell_time(schedule.bag_ns(now_s))
            time.sleep(max(0.0, min(wait_s, self._next_look_s - now_s, self._next_clock_s - now_s)))

    def _look(self) -> None:
        self._executor.spin_once(timeout_sec=0.0)
        self._refuse_if_in_danger(self._clock is not None)
        if self._toggled():
            self._set_pause(not self._schedule.paused)

    def _set_pause(self, wanted: bool) -> None:
        if wanted != self._schedule.paused:
            self._schedule.set_paused(wanted, time.monotonic())
            self._said_pause(wanted)

    def _tell_time(self, time_ns: int) -> None:
        """Publish the time in the bag, if it has advanced."""
        self._next_clock_s = time.monotonic() + _CLOCK_PERIOD_S
        if self._clock is None or time_ns <= self._clock_ns:
            return
        self._clock_ns = time_ns
        self._clock.publish(Clock(clock=to_time(time_ns)))

    def _refuse_if_in_danger(self, with_clock: bool) -> None:
        publishers = self.node.get_publishers_info_by_topic
        if with_clock and (others := self._others(publishers(topics.CLOCK))):
            expected = "expected nobody else (option --no-clock)"
            raise ReplayRefusedError(f"{others} publishes {topics.CLOCK}; {expected}")
        if not self._feeds_nodes:
            return
        if others := self._others(publishers(topics.JOINT_STATES)):
            raise ReplayRefusedError(
                f"{others} publishes {self.node.resolve_topic_name(topics.JOINT_STATES)}: an arm is there; "
                "expected none while recorded states go to the nodes"
            )
        for command_topic in topics.COMMANDS.values():
            infos = self.node.get_subscriptions_info_by_topic(command_topic)
            if others := self._others(infos, _HARMLESS_LISTENERS):
                raise ReplayRefusedError(
                    f"{others} listens to {self.node.resolve_topic_name(command_topic)}: it may be an arm, "
                    "which a controller that is fed with recorded states would move; expected nobody"
                )

    def _others(self, infos: list, harmless: frozenset[str] = frozenset()) -> str:
        return " and ".join(sorted({info.node_name for info in infos} - {self.node.get_name()} - harmless))

    def _end(self) -> None:
        self._executor.shutdown(timeout_sec=1.0)
        self.node.destroy_node()
        rclpy.try_shutdown()


def message_class(name: str) -> Any:
    """Return the class of a message type such as ``sensor_msgs/msg/JointState``; None: there is none here."""
    package, _, rest = name.partition("/")
    folder, _, kind = rest.rpartition("/")
    if not (package.isidentifier() and kind.isidentifier() and folder == "msg"):
        return None
    try:
        return getattr(import_module(f"{package}.msg"), kind, None)
    except ImportError:
        return None
