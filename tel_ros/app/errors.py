"""What can go wrong around the graph, with the exit code that tells it to scripts."""

from __future__ import annotations

import atexit
import os
import signal
import stat
import sys
import time
import traceback
from collections.abc import Callable
from typing import NoReturn

import click

from tel_ros.core.errors import TelError

EXIT_NOT_COMPLETED = 1
EXIT_BAD_INPUT = 2
EXIT_GRAPH_FAILED = 3
EXIT_INTERRUPTED = 130
_SAME_REQUEST_S = 2.0
_EXIT_TIMEOUT_S = 15.0


class GraphError(TelError):
    """The node graph did not come up, or broke down; with the exit code that tells why."""

    def __init__(self, message: str, exit_code: int = EXIT_GRAPH_FAILED) -> None:
        self.exit_code = exit_code
        super().__init__(message)


class Interrupted(KeyboardInterrupt):
    """Ctrl-C while nodes were running; says what was seen when they ended."""


class Interruption:
    """Has SIGINT, SIGTERM and SIGHUP raise KeyboardInterrupt; the same again within two seconds is ignored.

    Also where a script has started the command in the background, which makes it ignore SIGINT: an arm may
    be moving. Only what ``nohup`` has made it ignore stays so. When Python has ended, the process has 15 s
    left, whatever the middleware does.
    """

    SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    asked = False
    _again_at = 0.0
    held = False
    """Whether nothing may interrupt now: nodes are ending, and the arm with them."""

    @classmethod
    def watch(cls) -> None:
        """Begin."""
        cls.asked, cls._again_at = False, 0.0
        atexit.register(signal.setitimer, signal.ITIMER_REAL, _EXIT_TIMEOUT_S)
        cls.handle(cls._on_signal)

    @classmethod
    def handle(cls, handler: Callable[[int, object], None]) -> None:
        """Have another handler called for its signals."""
        for number in cls.SIGNALS:
            if number != signal.SIGHUP or signal.getsignal(number) != signal.SIG_IGN:
                signal.signal(number, handler)

    @staticmethod
    def leave_terminal() -> None:
        """After SIGHUP: an error on writing to a terminal that is gone must not keep anything from ending."""
        nowhere = os.open(os.devnull, os.O_RDWR)
        for each in range(3):
            if stat.S_ISCHR(os.fstat(each).st_mode):
                os.dup2(nowhere, each)

    @classmethod
    def check(cls) -> None:
        """Raise it once more: if a destructor or a foreign callback was running, it was lost there."""
        if cls.asked:
            raise KeyboardInterrupt

    @classmethod
    def errors(cls) -> tuple[type[BaseException], ...]:
        """Return what an interruption arrives as: pybind11 (rclpy) makes a RuntimeError of it in mid-call."""
        return (KeyboardInterrupt, RuntimeError) if cls.asked else (KeyboardInterrupt,)

    @classmethod
    def _on_signal(cls, number: int, frame: object) -> None:
        if number == signal.SIGHUP:
            cls.leave_terminal()
        if not cls.held and time.monotonic() > cls._again_at:
            cls.asked, cls._again_at = True, time.monotonic() + _SAME_REQUEST_S
            raise KeyboardInterrupt


def end(message: str, code: int) -> NoReturn:
    """Say in one line what happened, and exit; with TEL_DEBUG set, say first where it was raised."""
    if wants_traceback() and sys.exc_info()[0] is not None:
        traceback.print_exc()
    click.echo(f"tel: {message}", err=True)
    if code == EXIT_INTERRUPTED:
        for number in Interruption.SIGNALS:  # else one more would give another code while Python ends
            signal.signal(number, signal.SIG_IGN)
    sys.exit(code)


def wants_traceback() -> bool:
    """Whether whoever started this wants to see where an error comes from."""
    return bool(os.environ.get("TEL_DEBUG"))
