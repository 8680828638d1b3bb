"""Waiting for other nodes from inside a callback, with a time-out and a clear message."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from typing import Any

from rclpy.client import Client
from rclpy.node import Node
from rclpy.task import Future

from tel_ros.core.errors import TelError, look_alikes

AGAIN_S = 5.0
"""A good time to ask again after."""
_POLL_PERIOD_S = 0.1


class NoAnswerError(TelError):
    """Another node is not there, does not answer, or says that it failed."""


class SilenceError(NoAnswerError):
    """Another node is there and has not answered in time."""


class DeclinedError(NoAnswerError):
    """Another node has answered that it cannot do what was asked."""


def wait(future: Future, timeout_s: float, what: str, poll: Callable[[], None] = lambda: None) -> Any:
    """Return a future's result; some other thread has to spin the node.

    Args:
        future: of the answer.
        timeout_s: wall clock.
        what: is asked, for the message.
        poll: called ten times a second meanwhile; may raise to end the waiting.

    Raises:
        SilenceError: the time is over.
    """
    done = threading.Event()
    future.add_done_callback(lambda _: done.set())
    waited_s = 0.0
    while not done.wait(_POLL_PERIOD_S):
        waited_s += _POLL_PERIOD_S
        poll()
        if waited_s > timeout_s:
            raise SilenceError(f"{what} did not answer within {timeout_s:.1f} s")
    return future.result()


def ask(
    client: Client,
    request: Any,
    timeout_s: float,
    poll: Callable[[], None] = lambda: None,
    again_s: float = math.inf,
) -> Any:
    """Call a service, once it is there, and return its response.

    The first answer after the start of two nodes may be lost, although the service is there.

    Args:
        client: of the service.
        request: what to ask.
        timeout_s: for the service to be there, and for its answer.
        poll: as for :func:`wait`.
        again_s: after how long without an answer to ask once more; only for what may be done twice.

    Raises:
        NoAnswerError: it is not there or does not answer in time.
    """
    waited_s = 0.0
    while not client.service_is_ready():
        poll()
        if waited_s > timeout_s:
            raise NoAnswerError(f"there is no service {client.service_name} (waited {timeout_s:.1f} s)")
        time.sleep(_POLL_PERIOD_S)
        waited_s += _POLL_PERIOD_S
    left_s = timeout_s
    while left_s > again_s:
        future = client.call_async(request)
        try:
            return wait(future, again_s, client.service_name, poll)
        except SilenceError:
            client.remove_pending_request(future)
        left_s -= again_s
    return wait(client.call_async(request), left_s, client.service_name, poll)


def namespace_hint(node: Node, *topics: str) -> str:
    """Return a sentence that names existing topics which may be meant by missing ones; may be empty."""
    names = [name for name, _ in node.get_topic_names_and_types()]
    missing = [node.resolve_topic_name(topic) for topic in topics]
    alike = sorted({other for topic in missing for other in look_alikes(topic, names)})
    return f" There is {' and '.join(alike)}: is the namespace right?" if alike else ""
