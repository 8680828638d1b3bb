"""Waiting for other nodes from inside a callback, with a time-out and a clear message."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from typing import Any

from rclpy.action.client import ActionClient, ClientGoalHandle
from rclpy.client import Client
from rclpy.node import Node
from rclpy.task import Future

from tel_ros.core.errors import TelError, look_alikes

AGAIN_S = 5.0
"""A good time to ask again after."""
LOST_S = 1.0
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


def send_goal(client: ActionClient, kind: Any, goal: Any, on_feedback: Callable[[Any], None]) -> Future:
    """Send a goal of an action of this kind, and return the future of its handle.

    A server that has just started may lose the answer, because it has not discovered its client yet. Feedback
    on the goal tells as well that it was accepted; that counts where no answer has come within
    :data:`LOST_S`.
    """
    sent_at = time.monotonic()

    def heard(message: Any) -> None:  # of a type that rclpy makes
        if not sent.done() and time.monotonic() - sent_at > LOST_S:
            accepted = kind.Impl.SendGoalService.Response(accepted=True)
            sent.set_result(ClientGoalHandle(client, message.goal_id, accepted))
        on_feedback(message.feedback)

    sent: Future = client.send_goal_async(goal, feedback_callback=heard)
    return sent


def namespace_hint(node: Node, *topics: str) -> str:
    """Return a sentence that names existing topics which may be meant by missing ones; may be empty."""
    names = [name for name, _ in node.get_topic_names_and_types()]
    missing = [node.resolve_topic_name(topic) for topic in topics]
    alike = sorted({other for topic in missing for other in look_alikes(topic, names)})
    return f" There is {' and '.join(alike)}: is the namespace right?" if alike else ""
