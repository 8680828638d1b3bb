"""Waiting for other nodes from inside a callback, with a time-out and a clear message."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from typing import Any

from rclpy.action import ActionClient
from rclpy.client import Client
from rclpy.node import Node
from rclpy.task import Future

from tel_ros.core.errors import TelError, look_alikes

_POLL_PERIOD_S = 0.1
AGAIN_S = 5.0
"""A good time to ask again after."""


class NoAnswerError(TelError):
    """Another node is not there, does not answer, or says that it failed."""


class SilenceError(NoAnswerError):
    """Another node is there and has not answered in time."""


class DeclinedError(NoAnswerError):
    """Another node has answered that it cannot do what was asked."""


def wait(future: Future, timeout_s: float, what: str, poll: Callable[[], None] = lambda: None) -> Any:
    """Return a future's result; some other thread has to spin the node.

    Args:
        future: what to wait for.
        timeout_s: wall clock.
        what: for the message, as in "what did not answer".
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

    That a service is there does not mean that its answers find their way yet: the first one after the start
    of two nodes may be lost.

    Args:
        client: of the service.
        request: what to ask.
        timeout_s: for the service to be there, and for its answer (wall clock).
        poll: called ten times a second meanwhile; may raise to end the waiting.
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


def call(
    client: Client,
    request: Any,
    timeout_s: float,
    poll: Callable[[], None] = lambda: None,
    again_s: float = math.inf,
) -> Any:
    """Call a service whose response has ``success`` and ``message``; arguments as for :func:`ask`.

    Raises:
        NoAnswerError: it is not there or does not answer in time.
        DeclinedError: it did not succeed.
    """
    response = ask(client, request, timeout_s, poll, again_s)
    if not response.success:
        raise DeclinedError(f"{client.service_name}: {response.message}")
    return response


def send_goal(client: ActionClient, goal: Any, timeout_s: float, on_feedback: Callable[[Any], None]) -> Any:
    """Send an action goal and return its handle once it has been accepted.

    Raises:
        NoAnswerError: there is no such action, it does not answer in time, or it rejects the goal.
    """
    name = client._action_name  # rclpy gives no public access to it
    if not client.wait_for_server(timeout_sec=timeout_s):
        raise NoAnswerError(f"there is no action {name} (waited {timeout_s:.1f} s)")
    handle = wait(client.send_goal_async(goal, feedback_callback=on_feedback), timeout_s, name)
    if not handle.accepted:
        raise NoAnswerError(f"{name} rejected the goal")
    return handle


def namespace_hint(node: Node, *topics: str) -> str:
    """Return a sentence that names existing topics which may be meant by missing ones; may be empty."""
    names = [name for name, _ in node.get_topic_names_and_types()]
    missing = [node.resolve_topic_name(topic) for topic in topics]
    alike = sorted({other for topic in missing for other in look_alikes(topic, names)})
    return f" There is {' and '.join(alike)}: is the namespace right?" if alike else ""
