"""Spinning a node whose few busy topics must not wait for the executor's bookkeeping.

rclpy's executor builds a new wait set from all of a node's entities before every callback. That costs more
than a control tick does. Here the busy subscriptions have a wait set of their own that is reused, and
everything else (timers, services, actions, parameters) gets its turn every few milliseconds.

This uses rclpy's own building blocks (:data:`WaitSet`, ``take_message``), which are not documented. Where
they are missing, or ``TEL_ROS_PLAIN_EXECUTOR`` is set, the executor does all the work: slower, with the same
result.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence

from rclpy.executors import Executor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.subscription import Subscription

from tel_ros.core.types import NS_PER_S

PLAIN_EXECUTOR_VARIABLE = "TEL_ROS_PLAIN_EXECUTOR"
TURN_PERIOD_S = 0.02
_TURN_PERIOD_NS = round(TURN_PERIOD_S * NS_PER_S)
_MOST_AT_ONCE = 64
_CALLBACKS_A_TURN = 4

WaitSet = getattr(rclpy_implementation, "WaitSet", None)


def spin_hot(
    node: Node, executor: Executor, subscriptions: Sequence[Subscription], done: Callable[[], bool]
) -> None:
    """Spin a node until ``done``.

    Args:
        node: whose subscriptions they are; it has been added to the executor.
        executor: for everything else.
        subscriptions: the busy ones; empty: the executor does all the work.
        done: looked at whenever something has happened, and fifty times a second.
    """
    if not subscriptions or WaitSet is None or os.environ.get(PLAIN_EXECUTOR_VARIABLE):
        while not done():
            executor.spin_once()
        return
    handles = [subscription.handle for subscription in subscriptions]
    with node.context.handle:
        wait_set = WaitSet(len(handles), 0, 0, 0, 0, 0, node.context.handle)
    next_turn = 0.0
    while not done():
        wait_set.clear_entities()
        indices = [wait_set.add_subscription(handle) for handle in handles]
        wait_set.wait(_TURN_PERIOD_NS)
        for subscription, index in zip(subscriptions, indices, strict=True):
            if wait_set.is_ready("subscription", index):
                _take(subscription)
        if time.monotonic() >= next_turn:
            for _ in range(_CALLBACKS_A_TURN):
                executor.spin_once(timeout_sec=0)
            next_turn = time.monotonic() + TURN_PERIOD_S


def _take(subscription: Subscription) -> None:
    """Hand the messages that have arrived to the callback; not endlessly many, others want a turn as well."""
    for _ in range(_MOST_AT_ONCE):
        taken = subscription.handle.take_message(subscription.msg_type, subscription.raw)
        if taken is None:
            return
        subscription.callback(taken[0])
