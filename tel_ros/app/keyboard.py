"""Single keys from the terminal that a command runs in."""

from __future__ import annotations

import os
import select
import sys
import termios
import tty
from types import TracebackType


class SpaceBar:
    """Tells whether the space bar was pressed. Use it with ``with``; where there is no terminal it never is.

    Ctrl-C and Ctrl-Z keep their meaning.
    """

    def __init__(self) -> None:
        self._terminal = sys.stdin.fileno() if sys.stdin is not None and sys.stdin.isatty() else None
        self._before: list | None = None

    def __enter__(self) -> SpaceBar:
        """Have keys come one by one."""
        # A process in the background would be stopped for touching the terminal.
        if self._terminal is not None and os.tcgetpgrp(self._terminal) == os.getpgrp():
            self._before = termios.tcgetattr(self._terminal)
            tty.setcbreak(self._terminal)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Leave the terminal as it was."""
        if self._before is not None:
            termios.tcsetattr(self._terminal, termios.TCSADRAIN, self._before)

    @property
    def works(self) -> bool:
        """Whether there is a terminal to listen to."""
        return self._before is not None

    def pressed(self) -> bool:
        """Return whether it was pressed an odd number of times since the last call."""
        if self._before is None or os.tcgetpgrp(self._terminal) != os.getpgrp():
            return False
        spaces = 0
        while select.select([self._terminal], [], [], 0.0)[0]:
            keys = os.read(self._terminal, 64)
            if not keys:
                break
            spaces += keys.count(b" ")
        return spaces % 2 == 1
