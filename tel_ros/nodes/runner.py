"""Running one node as one process, from start-up to an orderly end."""

from __future__ import annotations

import gc
import os
import signal
import sys
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import rclpy
from rclpy.executors import Executor, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from tel_ros.core.errors import TelError
from tel_ros.nodes.hot_loop import spin_hot
from tel_ros.recording.shared_files import config_folder

EXIT_BAD_INPUT = 2
_LONGEST_STOP_S = 3.0  # less than `ros2 launch` waits before it becomes rude
_LAST_WORDS_S = 0.2  # for results that are on their way to whoever waits for them
_SAME_REQUEST_S = 1.0
_WISHES = ("batch_s", "pace", "turn_period_s")


def run_node(
    make_node: Callable[[], Node], make_executor: Callable[[], Executor] = SingleThreadedExecutor
) -> None:
    """Run a node until SIGINT or SIGTERM; then let it stop in good order, and exit.

    A node may have ``busy_subscriptions``, ``batch_s`` and ``turn_period_s`` for them, and a ``pace`` (see
    :func:`spin_hot`). One with ``stop()`` and ``stopped`` is spun on until it has stopped, for 3 s at most:
    rclpy's own signal handlers would not let a controller send its last command. A second signal ends it at
    once; two within a second are one request, as Ctrl-C under ``ros2 launch`` makes them. The exit code is 2
    if the node cannot use what it is given.
    """
    stopping: list[float] = []

    def on_signal(number: int, frame: object) -> None:
        if not stopping:
            stopping.append(time.monotonic())
        elif time.monotonic() - stopping[0] > _SAME_REQUEST_S:
            raise KeyboardInterrupt

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, on_signal)
    os.environ.setdefault("FASTRTPS_DEFAULT_PROFILES_FILE", str(config_folder() / "fastdds.xml"))
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node: Any = None
    try:
        node = make_node()
        executor: Any = make_executor()
        executor.add_node(node)
        # Python sees a signal only when it gets a turn: the timer gives it one while the node is idle.
        node.create_timer(0.2, lambda: None)
        # What exists by now stays: looking through it again and again would hold the loop up.
        gc.freeze()
        wishes = {name: getattr(node, name) for name in _WISHES if hasattr(node, name)}
        spin: Any = partial(spin_hot, node, executor, getattr(node, "busy_subscriptions", ()), **wishes)
        spin(lambda: bool(stopping))
        if hasattr(node, "stop"):
            node.stop()
            end = stopping[0] + _LONGEST_STOP_S
            spin(lambda: node.stopped or time.monotonic() > end)
            end = time.monotonic() + _LAST_WORDS_S
            spin(lambda: time.monotonic() > end)
        executor.shutdown(timeout_sec=1.0)
    except KeyboardInterrupt:
        pass
    except TelError as error:
        print(error, file=sys.stderr)
        sys.exit(EXIT_BAD_INPUT)
    finally:
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_IGN)
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
