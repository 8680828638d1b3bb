"""Spinning a node whose few busy topics must not wait for the executor's bookkeeping.

rclpy's executor builds a new wait set from all of a node's entities before every callback, which costs more
than a control tick. Here the busy subscriptions have a wait set of their own that is reused. Everything else
(timers, services, actions, parameters) gets its turn when no message has come for 20 ms, and every 50 ms (or
what a node asks for) in any case; with a :class:`Pace`, where it leaves time.

This uses rclpy's undocumented building blocks (:data:`WaitSet`, ``take_message``). Where they are missing, or
``TEL_ROS_PLAIN_EXECUTOR`` is set, the executor does all the work: slower, with the same result.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from typing import Protocol

from rclpy.callback_groups import CallbackGroup
from rclpy.executors import SingleThreadedExecutor, TimeoutException
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription

from tel_ros.nodes import qos

PLAIN_EXECUTOR_VARIABLE = "TEL_ROS_PLAIN_EXECUTOR"
TURN_PERIOD_S = 0.05
_IDLE_NS = 20_000_000
_IDLE_S = 0.2  # Python sees a signal only when it gets a turn
_TURN_TAKES_S = 0.0005
_MOST_AT_ONCE = 64

WaitSet = getattr(rclpy_implementation, "WaitSet", None)


class Pace(Protocol):
    """Something to do at times that must be kept."""

    @property
    def deadline_s(self) -> float:
        """When it is due next, by ``time.monotonic``."""

    def keep(self) -> None:
        """Do it, if it is due."""


def serves_itself() -> bool:
    """Return whether busy subscriptions are served here rather than by the executor."""
    return WaitSet is not None and not os.environ.get(PLAIN_EXECUTOR_VARIABLE)


class BusyGroup(CallbackGroup):
    """The callback group of busy subscriptions: the executor leaves them alone if they are served here."""

    def can_execute(self, entity: object) -> bool:
        """Return whether the executor may serve an entity."""
        return not serves_itself()

    beginning_execution = can_execute

    def ending_execution(self, entity: object) -> None:
        """Nothing to release."""


def busy_subscription(
    node: Node, kind: type, topic: str, callback: Callable[[bytes], None], profile: QoSProfile = qos.NEWEST
) -> Subscription:
    """Return a subscription that hears the newest message only, or as the profile says, as bytes."""
    return node.create_subscription(kind, topic, callback, profile, raw=True, callback_group=BusyGroup())


def spin_hot(
    node: Node,
    executor: SingleThreadedExecutor,
    subscriptions: Sequence[Subscription],
    done: Callable[[], bool],
    batch_s: float = 0.0,
    pace: Pace | None = None,
    turn_period_s: float = TURN_PERIOD_S,
) -> None:
    """Spin a node, which has been added to the executor, until ``done``.

    Args:
        node: whose subscriptions they are.
        executor: for everything else, or for all without busy subscriptions.
        subscriptions: the busy ones, of a :class:`BusyGroup`.
        done: asked whenever something has happened, and fifty times a second (five without busy ones).
        batch_s: how long to let messages gather before they are taken together.
        pace: what has to be done in time.
        turn_period_s: how long everything else may wait while messages keep coming. A turn costs 1 to 2 ms.
    """
    if not subscriptions or not serves_itself():
        while not done():
            executor.spin_once(_IDLE_S if pace is None else _left_s(pace))
            if pace is not None:
                pace.keep()
        return
    handles = [subscription.handle for subscription in subscriptions]
    with node.context.handle:
        wait_set = WaitSet(len(handles), 0, 0, 0, 0, 0, node.context.handle)
    next_turn = 0.0
    while not done():
        wait_set.clear_entities()
        indices = [wait_set.add_subscription(handle) for handle in handles]
        wait_set.wait(_IDLE_NS if pace is None else min(_IDLE_NS, round(_left_s(pace) * 1e9)))
        ready = [
            s for s, k in zip(subscriptions, indices, strict=True) if wait_set.is_ready("subscription", k)
        ]
        if ready and batch_s:
            time.sleep(batch_s)
        for subscription in ready:
            take(subscription)
        if pace is not None:
            pace.keep()
        late_s = time.monotonic() - next_turn
        # The rest may have its turn without making the pace late, or has waited too long.
        has_time = pace is None or _left_s(pace) >= _TURN_TAKES_S or late_s > TURN_PERIOD_S
        if (not ready and pace is None) or (late_s >= 0.0 and has_time):
            serve_ready(executor)
            next_turn = time.monotonic() + turn_period_s


def _left_s(pace: Pace) -> float:
    return max(0.0, pace.deadline_s - time.monotonic())


def take(subscription: Subscription) -> None:
    """Hand the messages that have arrived to the callback; a limited number, others want a turn as well."""
    # Looked up once: each of these costs a good part of taking a message.
    take_message, callback = subscription.handle.take_message, subscription.callback
    kind, raw = subscription.msg_type, subscription.raw
    for _ in range(min(subscription.qos_profile.depth, _MOST_AT_ONCE)):
        taken = take_message(kind, raw)
        if taken is None:
            return
        callback(taken[0])


def serve_ready(executor: SingleThreadedExecutor) -> None:
    """Run every callback that is ready now, from one wait set."""
    try:
        while True:
            run, _, _ = executor.wait_for_ready_callbacks(0)
            run()
            run.result()  # raises what the callback has raised
    except TimeoutException:
        return
