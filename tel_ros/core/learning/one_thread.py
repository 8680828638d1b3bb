"""Linear algebra on one thread.

The matrices are small enough that a second thread gains little. It loses much where other processes want the
cores: threads of BLAS wait for each other by spinning (training of 17 short trials beside two busy processes:
9.4 s, on one thread 0.7 s). And results no longer depend on the number of cores.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import ParamSpec, TypeVar

import scipy.linalg  # noqa: F401 - its BLAS has to be loaded before it can be found

try:
    from threadpoolctl import ThreadpoolController
except ImportError:  # rosdep has no key for it: without, it is slower on busy machines, and right
    ThreadpoolController = None

P = ParamSpec("P")
R = TypeVar("R")
_POOLS = ThreadpoolController and ThreadpoolController()


def on_one_thread(function: Callable[P, R]) -> Callable[P, R]:
    """Return a function that does its linear algebra on one thread, if threadpoolctl is installed."""
    if _POOLS is None:
        return function

    @functools.wraps(function)
    def wrapped(*args: P.args, **kwargs: P.kwargs) -> R:
        with _POOLS.limit(limits=1, user_api="blas"):
            return function(*args, **kwargs)

    return wrapped
