"""Processes of this machine that compute for this one, and end with it, however that ends."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing.connection import Connection, wait


@contextmanager
def worker_pool(jobs: int) -> Iterator[ProcessPoolExecutor]:
    """Give a pool of processes; when it is left, what is not finished is given up.

    Args:
        jobs: how many at once.
    """
    # Not by fork: what the parent has loaded may have threads, and these do not survive it.
    context = multiprocessing.get_context("spawn")
    # The other end closes when this process ends, by whatever: then workers end, in the middle of their work.
    watched, held = context.Pipe(duplex=False)
    pool = ProcessPoolExecutor(jobs, context, initializer=_end_with, initargs=(watched,))
    try:
        yield pool
    finally:
        pool.shutdown(wait=False, cancel_futures=True)
        held.close()
        pool.shutdown(wait=True)
        watched.close()


def _end_with(watched: Connection) -> None:
    """Let this worker end when its parent does; Ctrl-C on the terminal is the parent's business."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def watch() -> None:
        wait([watched])
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
