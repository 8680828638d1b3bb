"""What can go wrong around the graph, with the exit code that tells it to scripts."""

from __future__ import annotations

import os
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


def end(message: str, code: int) -> NoReturn:
    """Say in one line what happened, and exit; with TEL_DEBUG set, say first where it was raised."""
    if wants_traceback() and sys.exc_info()[0] is not None:
        traceback.print_exc()
    click.echo(f"tel: {message}", err=True)
    sys.exit(code)


def wants_traceback() -> bool:
    """Whether whoever started this wants to see where an error comes from."""
    return bool(os.environ.get("TEL_DEBUG"))
