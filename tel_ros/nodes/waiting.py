"""Waiting for other nodes from inside a callback, with a time-out and a clear message."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Sequence
from typing import Any

from rcl_interfaces.srv import GetParameters
from rclpy.action.client import ActionClient
from rclpy.client import Client
from rclpy.executors import MultiThreadedExecutor
from rclpy.node import Node
from rclpy.task import Future

from tel_ros.core.errors import TelError, look_alikes

AGAIN_S = 0.2
"""When to ask a node again that has not answered yet."""
ASK_PERIOD_S = 2.0
_POLL_PERIOD_S = 0.1


class NoAnswerError(TelError):
    """Another node is not there, does not answer, or says that it failed."""


class SilenceError(NoAnswerError):
    """Another node is there and has not answered in time."""


class DeclinedError(NoAnswerError):
    """Another node has answered that it cannot do what was asked."""


def wait(future: Future, timeout_s: float, what: str, poll: Callable[[], None] = lambda: None) -> Any:
    """Return a future's result, or raise SilenceError; some other thread has to spin the node.

    ``what`` is asked, for the message. ``poll`` is called ten times a second; it may raise to end this.
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
    """Call a service and return its response; NoAnswerError: it is not there or does not answer in time.

    The time-out counts for either. ``again_s``: after how long without an answer to ask once more; only for
    what may be done twice.
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


def meet(clients: Sequence[Client], timeout_s: float, poll: Callable[[], None]) -> None:
    """Wait until the nodes behind these clients of ``get_parameters`` know all that was made here before.

    A service that does not know where its client hears answers drops them (rmw_fastrtps, after 0.1 s),
    although the client sees the service. Discovery tells of a process's endpoints in the order in which they
    were made: who has answered the client that was made last knows all of them. Raises like :func:`ask`.
    """
    for client in clients:
        ask(client, GetParameters.Request(), timeout_s, poll, AGAIN_S)


class Liveness:
    """Asks another node for no parameters, again and again, and notes whether it answers.

    Only for nodes whose executor has a thread to spare: one that computes in its only thread looks dead. The
    first answer tells what :func:`meet` waits for. ``node`` asks, and its owner spins it.
    """

    def __init__(self, node: Node, name: str, clock: Callable[[], float] = time.monotonic) -> None:
        self._client, self._clock = node.create_client(GetParameters, f"{name}/get_parameters"), clock
        self._asked_at, self._silent_since = -math.inf, math.inf
        self.met = False
        """Whether it has ever answered."""

    def ask(self) -> float:
        """Ask again when it is time; return for how long no question has been answered, in s."""
        now = self._clock()
        period_s = ASK_PERIOD_S if self.met else AGAIN_S
        if now - self._asked_at > period_s and self._client.service_is_ready():
            self._asked_at, self._silent_since = now, min(self._silent_since, now)
            self._client.call_async(GetParameters.Request()).add_done_callback(self._hear)
        return max(0.0, now - self._silent_since)

    def _hear(self, answer: Future) -> None:
        self.met, self._silent_since = True, math.inf


def _locked(method: Callable[..., Any]) -> Any:
    def call(client: LockedActionClient, *args: Any, **kwargs: Any) -> Any:
        with client.sending:
            return method(client, *args, **kwargs)

    return call


class LockedActionClient(ActionClient):
    """A client whose requests may be made in one thread while others spin its node.

    rclpy's notes a request only after it has been sent: an answer that another thread takes in between is
    unexpected there, and lost.
    """

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        self.sending = threading.Lock()
        super().__init__(*args, **kwargs)

    send_goal_async = _locked(ActionClient.send_goal_async)
    _cancel_goal_async = _locked(ActionClient._cancel_goal_async)
    _get_result_async = _locked(ActionClient._get_result_async)
    take_data = _locked(ActionClient.take_data)


def namespace_hint(node: Node, *topics: str) -> str:
    """Return a sentence that names existing topics which may be meant by missing ones; may be empty."""
    names = [name for name, _ in node.get_topic_names_and_types()]
    missing = [node.resolve_topic_name(topic) for topic in topics]
    alike = sorted({other for topic in missing for other in look_alikes(topic, names)})
    return f" There is {' and '.join(alike)}: is the namespace right?" if alike else ""


class PatientExecutor(MultiThreadedExecutor):
    """Ends after the callbacks that have begun, as rclpy 7.1 means to: it takes away what they need."""

    def shutdown(self, timeout_sec: float = 1.0) -> bool:
        """Wait for them first."""
        end = time.monotonic() + timeout_sec
        while not all(callback.done() for callback in self._futures) and time.monotonic() < end:
            time.sleep(0.005)
        return bool(super().shutdown(timeout_sec))
