"""ROS domains that belong to one test at a time, whatever else is tested on this machine."""

from __future__ import annotations

import itertools
import os
import random
import socket
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

DOMAINS = range(1, 101)
"""ROS keeps some of the higher ones for the system's own ports."""
_worker = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw"))
_mine = DOMAINS[_worker :: int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))]
_turn = itertools.cycle(random.sample(_mine, len(_mine)))
"""Each worker has domains of its own: what another one has left in one would not be gone yet."""


@contextmanager
def held_domains() -> Iterator[Iterator[int]]:
    """Hand out domains, each of which nobody else gets until this is left or its process has ended.

    Who has bound its name in the kernel owns a domain. It comes again after all others, so that what the
    test before has left there is gone.
    """
    with ExitStack() as held:
        yield (_taken(held) for _ in itertools.count())


def _taken(held: ExitStack) -> int:
    for number in _turn:
        owner = socket.socket(socket.AF_UNIX)
        try:
            owner.bind(f"\0tel_ros test in ROS domain {number}")
        except OSError:
            owner.close()
            time.sleep(0.01)
        else:
            held.enter_context(owner)
            return number
    raise AssertionError("a cycle has no end")
