"""What can go wrong around the graph, with the exit code that tells it to scripts."""

from __future__ import annotations

import os
import signal
import stat
import sys
import traceback
from typing import NoReturn

import click

from tel_ros.core.errors import TelError

EXIT_NOT_COMPLETED = 1
EXIT_BAD_INPUT = 2
EXIT_GRAPH_FAILED = 3
EXIT_INTERRUPTED = 130


class GraphError(TelError):
    """The node graph did not come up, or broke down; with the exit code that tells why."""

    def __init__(self, message: str, exit_code: int = EXIT_GRAPH_FAILED) -> None:
        self.exit_code = exit_code
        super().__init__(message)


class Interrupted(KeyboardInterrupt):
    """Ctrl-C while nodes were running; says what was seen when they ended."""


class Interruption:
    """Has SIGINT, SIGTERM and SIGHUP raise KeyboardInterrupt once; whatever comes after that is ignored.

    Also where a script has started the command in the background, which makes it ignore SIGINT: an arm may
    be moving. Only what ``nohup`` has made it ignore stays so.
    """

    SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    asked = False
    held = False
    """Whether nothing may interrupt now: nodes are ending, and the arm with them."""

    @classmethod
    def watch(cls) -> None:
        """Begin."""
        cls.asked = False
        for number in cls.SIGNALS:
            if number != signal.SIGHUP or signal.getsignal(number) != signal.SIG_IGN:
                signal.signal(number, cls._on_signal)

    @classmethod
    def check(cls) -> None:
        """Raise it once more: if a destructor or a foreign callback was running, it was lost there."""
        if cls.asked:
            raise KeyboardInterrupt

    @classmethod
    def _on_signal(cls, number: int, frame: object) -> None:
        if number == signal.SIGHUP:
            # The terminal is gone; an error on writing there must not keep the nodes from ending in order.
            nowhere = os.open(os.devnull, os.O_RDWR)
            for each in range(3):
                if stat.S_ISCHR(os.fstat(each).st_mode):
                    os.dup2(nowhere, each)
        if not (cls.asked or cls.held):
            cls.asked = True
            raise KeyboardInterrupt


def end(message: str, code: int) -> NoReturn:
    """Say in one line what happened, and exit; with TEL_DEBUG set, say first where it was raised."""
    if wants_traceback() and sys.exc_info()[0] is not None:
        traceback.print_exc()
    click.echo(f"tel: {message}", err=True)
    sys.exit(code)


def wants_traceback() -> bool:
    """Whether whoever started this wants to see where an error comes from."""
    return bool(os.environ.get("TEL_DEBUG"))
