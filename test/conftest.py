"""What the tests of all folders share."""

from __future__ import annotations

import itertools
import os
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent / "core"))  # tests of all layers use its made-up recordings

_N_DOMAINS = 100
"""ROS keeps some of the higher ones for the system's own ports."""


@pytest.fixture(scope="session")
def ros_domains() -> Iterator[int]:
    """Return ROS domains, each of which no other test has at the same time, in this or another worker."""
    worker = os.environ.get("PYTEST_XDIST_WORKER", "")
    n_workers = int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))
    # Another run of the tests begins elsewhere; the workers of one have the same parent.
    start = os.getppid() if worker else os.getpid()
    turn = int(worker.removeprefix("gw") or "0")
    return (1 + (start + k * n_workers + turn) % _N_DOMAINS for k in itertools.count())
