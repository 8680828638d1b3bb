"""The one place from which effort commands leave."""

from __future__ import annotations

from rclpy.node import Node
from std_msgs.msg import Float64MultiArray

from tel_ros.core.safety.layer import SafetyLayer
from tel_ros.nodes import qos
from tel_ros.nodes.conversions import EffortCommand
from tel_ros.recording import topics


class EffortChannel:
    """Publishes what a safety layer has last permitted, and nothing while it is shut.

    It takes no efforts: there is no way around the layer. Nothing else in the package makes a publisher of
    the command topic, so that whatever reaches an arm is found by looking for who uses this class.

    Args:
        node: that commands.
        n_joints: number of efforts.
        author: put on the commands instead of the stamp that they answer; they then count as the answer to
            the newest state. Empty: the stamp.
    """

    def __init__(self, node: Node, n_joints: int, author: str = "") -> None:
        self._node, self._author = node, author
        self._layer: SafetyLayer | None = None
        self._command = EffortCommand(n_joints)
        self._pub = node.create_publisher(Float64MultiArray, topics.EFFORT_COMMANDS, qos.STREAM)

    def open(self, layer: SafetyLayer) -> None:
        """Pass on, from now on, what this layer permits."""
        self._layer = layer

    def shut(self) -> None:
        """Pass nothing on any more."""
        self._layer = None

    @property
    def listeners(self) -> int:
        """How many subscriptions hear the commands."""
        return int(self._pub.get_subscription_count())

    def send(self, stamp_ns: int) -> None:
        """Command what the layer has last permitted, in answer to the joint state with this stamp."""
        if self._layer is not None:
            label = self._author or str(stamp_ns)
            self._pub.publish(self._command.fill(label, self._layer.last_nm))

    def repeat(self) -> None:
        """Command the same once more, for an arm that has not heard it."""
        if self._layer is not None:
            self._pub.publish(self._command.message)

    def destroy(self) -> None:
        """Take the publisher back."""
        self.shut()
        self._node.destroy_publisher(self._pub)
