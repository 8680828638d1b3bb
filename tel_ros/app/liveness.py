"""Noticing that a node whose process lives no longer answers."""

from __future__ import annotations

import time
from collections.abc import Callable

from rcl_interfaces.srv import GetParameters
from rclpy.node import Node
from rclpy.task import Future

from tel_ros.app.errors import GraphError

ASK_PERIOD_S = 2.0
SILENCE_TIMEOUT_S = 20.0
"""A machine may stand still for some seconds."""


class Liveness:
    """Asks a node for no parameters, again and again; its executor answers.

    Only for nodes whose executor has a thread to spare: one that computes in its only thread looks dead.

    Args:
        node: that asks; its owner spins it.
        name: of the node that is asked.
        clock: tells the time in s.
    """

    def __init__(self, node: Node, name: str, clock: Callable[[], float] = time.monotonic) -> None:
        self._node, self._name, self._clock = node, name, clock
        self._client = node.create_client(GetParameters, f"{name}/get_parameters")
        self._asked: Future | None = None
        self._asked_at = clock()

    def check(self) -> None:
        """Ask again when it is time.

        Raises:
            GraphError: there was no answer for :data:`SILENCE_TIMEOUT_S`.
        """
        silence_s = self._clock() - self._asked_at
        if self._asked is not None and not self._asked.done():
            if silence_s > SILENCE_TIMEOUT_S:
                raise GraphError(f"node {self._name} has not answered for {silence_s:.0f} s")
        elif silence_s > ASK_PERIOD_S and self._client.service_is_ready():
            self._asked, self._asked_at = self._client.call_async(GetParameters.Request()), self._clock()

    def close(self) -> None:
        """Ask no more."""
        self._node.destroy_client(self._client)
