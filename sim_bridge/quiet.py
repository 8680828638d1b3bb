"""Keeps what a C++ library prints away from a program's output."""

from __future__ import annotations

import ctypes
import os
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def stdout_to_stderr() -> Iterator[None]:
    """Send everything written to the process's standard output to standard error instead.

    PyBullet prints remarks on standard output, past ``sys.stdout``; there they would end up in the middle of
    JSON that another program reads. Works on the whole process, so keep it short: loading, not stepping.
    """
    libc = ctypes.CDLL(None)
    libc.fflush(None)
    kept = os.dup(1)
    os.dup2(2, 1)
    try:
        yield
    finally:
        # C's own buffer would otherwise be written after the switch back.
        libc.fflush(None)
        os.dup2(kept, 1)
        os.close(kept)
