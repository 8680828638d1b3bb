"""Who else is on the arm's topics: nobody should be."""

from __future__ import annotations

from rclpy.node import Node

from tel_ros.recording import topics

_UNKNOWN_NODE = "_NODE_NAME_UNKNOWN_"


class CompetingPublishers:
    """Looks for others who command the arm, and for a second publisher that speaks for it.

    A publisher whose node is not known yet is not counted.

    Args:
        node: that commands.
        command_topic: on which it does.
    """

    def __init__(self, node: Node, command_topic: str) -> None:
        self._node = node
        self._command_topic = node.resolve_topic_name(command_topic)
        self._states_topic = node.resolve_topic_name(topics.JOINT_STATES)
        guard = topics.absolute(topics.ARM_GUARD, node.get_namespace())
        self._ours = {_shown(node.get_fully_qualified_name()), _shown(guard)}
        self.of_commands = ""
        """Who commands the arm as well, in words; empty: nobody does, apart from the guard."""
        self.of_states = ""
        """Who publishes joint states, in words; empty: one node at most."""

    def __str__(self) -> str:
        """Return what is wrong; empty: nothing."""
        return self.of_states or self.of_commands

    def look(self) -> None:
        """Look again."""
        others = set(self._publishers(self._command_topic)) - self._ours
        self.of_commands = (
            f"{', '.join(sorted(others))} commands the arm on {self._command_topic}, too" if others else ""
        )
        speakers = self._publishers(self._states_topic)
        self.of_states = (
            f"{' and '.join(speakers)} publish {self._states_topic}: who speaks for the arm?"
            if len(speakers) > 1
            else ""
        )

    def _publishers(self, topic: str) -> list[str]:
        """Return the node of each publisher of a topic, if there are several."""
        # Counting costs little, asking for names does not.
        if self._node.count_publishers(topic) <= 1:
            return []
        infos = self._node.get_publishers_info_by_topic(topic)
        known = [info for info in infos if info.node_name != _UNKNOWN_NODE]
        return sorted(_shown(topics.absolute(info.node_name, info.node_namespace)) for info in known)


def _shown(full_name: str) -> str:
    """Return the name of a node as people write it where there are no namespaces."""
    return full_name.removeprefix("/")
