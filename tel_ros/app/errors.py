"""What can go wrong around the graph, with the exit code that tells it to scripts."""

from __future__ import annotations

from tel_ros.core.errors import TelError

EXIT_NOT_COMPLETED = 1
EXIT_BAD_INPUT = 2
EXIT_GRAPH_FAILED = 3
EXIT_INTERRUPTED = 130


class GraphError(TelError):
    """The node graph did not come up, or broke down."""


class NodeDiedError(GraphError):
    """A node's process ended although the run had not."""
