"""The one place from which commands leave, and a look at who else is on the arm's topics."""

from __future__ import annotations

from rclpy.node import Node
from std_msgs.msg import Float64MultiArray

from tel_ros.core.control.set_point import SetPointGuard
from tel_ros.core.safety.layer import SafetyLayer
from tel_ros.nodes import qos
from tel_ros.recording import topics
from tel_ros.recording.cdr import packed_command

LEFT = {
    "effort": "zero effort",
    "position": "the drive holds its last set point",
    "trajectory": "the trajectory controller is told to hold where the arm is",
}
"""What becomes of an arm whose states are lost."""
_UNKNOWN_NODE = "_NODE_NAME_UNKNOWN_"


class CommandChannel:
    """Publishes what its source has last permitted, and nothing while it is shut.

    It takes no values: there is no way around the source. Nothing else in the package makes a publisher of
    a command topic, so that whatever reaches an arm is found by looking for who uses this class.

    ``author`` is put on the commands instead of the stamp that they answer; they then count as the answer to
    the newest state. Empty: the stamp.
    """

    problem = ""
    """Why nothing can be sent although somebody listens: there is no such reason."""

    def __init__(self, node: Node, interface: str, author: str = "") -> None:
        self._node, self._interface, self._author = node, interface, author
        self._source: SafetyLayer | SetPointGuard | None = None
        self._newest: bytes | None = None
        self._pub = node.create_publisher(Float64MultiArray, topics.COMMANDS[interface], qos.STREAM)
        self.topic: str = self._pub.topic_name

    def open(self, source: SafetyLayer | SetPointGuard) -> None:
        """Pass on, from now on, what this source permits: it has the last word on commands."""
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

    def destroy(self) -> None:
        """Take the publisher back."""
        self.shut()
        self._node.destroy_publisher(self._pub)


class CompetingPublishers:
    """Looks for others than the ``commander`` (empty: this node), and for a second publisher of states."""

    def __init__(self, node: Node, command_topic: str, commander: str = "") -> None:
        self._node = node
        self.command_topic = node.resolve_topic_name(command_topic)
        self._states_topic = node.resolve_topic_name(topics.JOINT_STATES)
        guard = topics.absolute(topics.ARM_GUARD, node.get_namespace())
        self._ours = {_shown(commander or node.get_fully_qualified_name()), _shown(guard)}
        self.of_commands = ""
        """Which nodes command the arm as well; empty: none, apart from the guard."""
        self.of_states = ""
        """Which nodes publish joint states; empty: one at most."""

    def look(self) -> None:
        """Look again."""
        others = set(self._publishers(self.command_topic)) - self._ours
        speakers = self._publishers(self._states_topic)
        self.of_commands = self.of_states = ""
        if others:
            self.of_commands = f"{', '.join(sorted(others))} commands the arm on {self.command_topic}, too"
        if len(speakers) > 1:
            self.of_states = f"{' and '.join(speakers)} publish {self._states_topic}: who speaks for the arm?"

    def _publishers(self, topic: str) -> list[str]:
        """Return the node of each publisher of a topic, as far as it is known, if there are several."""
        # Counting costs little, asking for names does not.
        if self._node.count_publishers(topic) <= 1:
            return []
        infos = self._node.get_publishers_info_by_topic(topic)
        known = [info for info in infos if info.node_name != _UNKNOWN_NODE]
        return sorted(_shown(topics.absolute(info.node_name, info.node_namespace)) for info in known)


def _shown(full_name: str) -> str:
    """Return the name of a node as people write it where there are no namespaces."""
    return full_name.removeprefix("/")
