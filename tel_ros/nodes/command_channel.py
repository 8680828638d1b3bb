"""The one place from which commands leave."""

from __future__ import annotations

from typing import Literal, Protocol

from rclpy.node import Node
from std_msgs.msg import Float64MultiArray

from tel_ros.core.types import FloatArray
from tel_ros.nodes import qos
from tel_ros.nodes.hot_messages import packed_command
from tel_ros.recording import topics


class CommandSource(Protocol):
    """What has the last word on commands: the safety layer, or the guard of set points behind it."""

    @property
    def last_command(self) -> FloatArray | None:
        """Efforts in N·m or set points in rad, shape (n_joints,); None: there has been none."""


class CommandChannel:
    """Publishes what its source has last permitted, and nothing while it is shut.

    It takes no values: there is no way around the source. Nothing else in the package makes a publisher of
    a command topic, so that whatever reaches an arm is found by looking for who uses this class.

    Args:
        node: that commands.
        interface: of the arm.
        author: put on the commands instead of the stamp that they answer; they then count as the answer to
            the newest state. Empty: the stamp.
    """

    def __init__(self, node: Node, interface: Literal["effort", "position"], author: str = "") -> None:
        self._node, self._interface, self._author = node, interface, author
        self._source: CommandSource | None = None
        self._newest: bytes | None = None
        self._pub = node.create_publisher(Float64MultiArray, topics.COMMANDS[interface], qos.STREAM)
        self.topic: str = self._pub.topic_name

    def open(self, source: CommandSource) -> None:
        """Pass on, from now on, what this source permits."""
        self._source = source

    def shut(self) -> None:
        """Pass nothing on any more."""
        self._source = None

    @property
    def listeners(self) -> int:
        """How many subscriptions hear the commands."""
        return int(self._pub.get_subscription_count())

    def send(self, stamp_ns: int) -> None:
        """Command what the source has last permitted, in answer to the joint state with this stamp."""
        command = None if self._source is None else self._source.last_command
        if command is not None:
            self._newest = packed_command(self._author or str(stamp_ns), command)
            self._pub.publish(self._newest)

    def repeat(self) -> None:
        """Command the same once more, for an arm that has not heard it."""
        if self._source is not None and self._newest is not None:
            self._pub.publish(self._newest)

    def release(self, stamp_ns: int) -> None:
        """Command zero effort, when the source permits nothing else any more.

        Position drives get nothing: zeros would be a posture, and they hold their last set point by
        themselves.
        """
        if self._interface == "effort":
            self.send(stamp_ns)

    def destroy(self) -> None:
        """Take the publisher back."""
        self.shut()
        self._node.destroy_publisher(self._pub)
