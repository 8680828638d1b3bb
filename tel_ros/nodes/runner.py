"""Running one node as one process, from start-up to an orderly end."""

from __future__ import annotations

import gc
import re
import signal
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any

import rclpy
from rclpy.context import Context
from rclpy.exceptions import NameValidationException, ParameterException
from rclpy.executors import Executor, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args

from tel_ros.core.errors import TelError
from tel_ros.local_stop import BRAKE_SIGNAL
from tel_ros.nodes.clock import ClockWatch
from tel_ros.nodes.environment import choose_profiles, require_log_folder
from tel_ros.nodes.hot_loop import spin_hot
from tel_ros.nodes.preloaded import take_order
from tel_ros.recording.config_file import read_yaml

EXIT_BAD_INPUT = 2
END_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_LONGEST_STOP_S = 3.0  # less than `ros2 launch` waits before it becomes rude
_LONGEST_END_S = 3.0  # of what comes after it
_LAST_WORDS_S = 0.2  # for results that are on their way to whoever waits for them
_WISHES = ("batch_s", "pace", "turn_period_s")
NO_LOG_FILE = "--disable-external-lib-logs"


def start_ros(
    arguments: Sequence[str] = ("tel", "--ros-args", NO_LOG_FILE), context: Context | None = None
) -> None:
    """Initialise rclpy without signal handlers, by default as a command without log file; or TelError."""
    for option, file in pairwise(arguments):
        if option == "--params-file":
            read_yaml(Path(file))
    choose_profiles()
    expected = "expected --ros-args -p NAME:=VALUE -r FROM:=TO …"
    try:
        ignored = remove_ros_args(list(arguments))[1:]
        if not ignored:
            rclpy.init(args=list(arguments), context=context, signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:
        said = re.sub(r"Failed to parse ROS arguments: |. Error: Expected lexeme.*", "", str(error))
        said = re.sub(r",? at /\S+:\d+|\n", "", said)
        raise TelError(f"ROS does not start: {said}; {expected}") from None
    if ignored:
        raise TelError(f"{' '.join(ignored)!r} is no argument of this node; {expected}")


@contextmanager
def client(name: str, namespace: str = "/") -> Iterator[tuple[Node, SingleThreadedExecutor]]:
    """Start ROS with a node of a command and its executor, and end both."""
    start_ros()
    node, executor = Node(name, namespace=namespace), SingleThreadedExecutor()
    executor.add_node(node)
    try:
        yield node, executor
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


def run_node(
    make_node: Callable[[], Node], make_executor: Callable[[], Executor] = SingleThreadedExecutor
) -> None:
    """Run a node until SIGINT, SIGTERM or SIGHUP; then let it stop in good order, and exit.

    A node may have ``companions``, other nodes of the process; ``busy_subscriptions``, ``batch_s`` and
    ``turn_period_s`` for them, a ``pace`` (see :func:`spin_hot`); and ``serve``, which is called in every
    turn. One with ``stop()`` and ``stopped`` is spun on until it has stopped, for 3 s at most: rclpy's own
    signal handlers would not let a controller send its last command. Signals that come meanwhile change
    nothing. After that it has 3 s left, whatever the middleware does: Fast DDS sometimes blocks for ever. The
    exit code is 2 if the node cannot use what it is given.
    """
    take_order()
    try:
        _run(make_node, make_executor)
    finally:
        for number in END_SIGNALS:
            signal.signal(number, signal.SIG_DFL)
        # Frozen, what refers to the participant would keep it to the end, and others would not see it go.
        gc.unfreeze()
        gc.collect()
        gc.freeze()  # the rest goes with the process, which then ends a second sooner


def _run(make_node: Callable[[], Node], make_executor: Callable[[], Executor]) -> None:
    asked, ending = list[float](), list[float]()
    node: Any = None
    executor: Any = None
    whole = False

    def on_signal(number: int, frame: object) -> None:
        asked.append(time.monotonic())
        if number == BRAKE_SIGNAL:
            return
        if not ending:
            signal.setitimer(signal.ITIMER_REAL, _LONGEST_STOP_S + _LAST_WORDS_S + _LONGEST_END_S)
        ending.append(asked[-1])
        if not whole:
            raise KeyboardInterrupt

    # Its default action ends the process without Python's help.
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    for number in (*END_SIGNALS, BRAKE_SIGNAL):
        if number != signal.SIGHUP or signal.getsignal(number) != signal.SIG_IGN:  # as nohup wants it
            signal.signal(number, on_signal)
    try:
        if NO_LOG_FILE not in sys.argv:
            require_log_folder()
        start_ros(sys.argv)
        node, executor = make_node(), make_executor()
        for each in (node, *getattr(node, "companions", ())):
            executor.add_node(each)
        ClockWatch(node)
        # What exists by now stays: looking through it again and again would hold the loop up.
        gc.freeze()
        whole = True
        wishes = {name: getattr(node, name) for name in _WISHES if hasattr(node, name)}
        subscriptions, serve = getattr(node, "busy_subscriptions", ()), getattr(node, "serve", lambda: None)

        def spin(done: Callable[[], bool]) -> None:
            spin_hot(node, executor, subscriptions, lambda: serve() or done(), **wishes)

        spin(lambda: bool(asked))
        if hasattr(node, "stop"):
            node.stop()
            spin(lambda: bool(ending))
            end = ending[0] + _LONGEST_STOP_S
            spin(lambda: node.stopped or time.monotonic() > end)
            end = time.monotonic() + _LAST_WORDS_S
            spin(lambda: time.monotonic() > end)
    except (KeyboardInterrupt, RuntimeError):  # pybind11, and so rclpy, makes the other of it in mid-call
        if whole or not ending:
            raise
    except (TelError, ParameterException, NameValidationException) as error:
        print(error, file=sys.stderr)
        sys.exit(EXIT_BAD_INPUT)
    finally:
        for number in END_SIGNALS:
            signal.signal(number, signal.SIG_IGN)
        signal.setitimer(signal.ITIMER_REAL, _LONGEST_END_S)
        if node is not None:
            if whole:
                executor.shutdown(timeout_sec=1.0)
            node.destroy_node()
        rclpy.try_shutdown()
