"""Tasks side by side: on processes of this machine, or with Ray, here or on a cluster.

Results come as they are ready. However the caller ends, even if it is killed, its workers end as well.
"""

from __future__ import annotations

import importlib.util
import logging
import multiprocessing
import os
import secrets
import signal
import threading
from collections.abc import Callable, Generator, Hashable, Mapping
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from typing import Any, Literal, TypeVar

from tel_ros.core.errors import ConfigError, TelError

Executor = Literal["auto", "ray", "processes"]
K = TypeVar("K", bound=Hashable)
R = TypeVar("R")


class WorkersBrokenError(TelError):
    """The workers broke down; tasks that were finished before have given their results."""


class TaskFailedError(TelError):
    """A task raised; the message names it and says why."""


@dataclass(frozen=True)
class Failure:
    """What a task that raised gives."""

    message: str


@dataclass(frozen=True)
class Workforce:
    """Who computes: so many tasks at once on this machine (None: one a core), or a Ray cluster at an address.

    ``auto``: Ray where it is installed, else processes.

    Raises:
        ConfigError: the values do not go together, or Ray is needed and not installed.
    """

    jobs: int | None = None
    executor: Executor = "processes"
    address: str | None = None

    def __post_init__(self) -> None:
        if self.jobs is not None and self.jobs < 1:
            raise ConfigError("--jobs", self.jobs, "a whole number of at least 1")
        if self.jobs is not None and self.address is not None:
            raise ConfigError("--jobs", self.jobs, "no --jobs with --address: a cluster has its own cores")
        _ = self.with_ray

    @property
    def n_jobs(self) -> int:
        return self.jobs or len(os.sched_getaffinity(0))

    @property
    def with_ray(self) -> bool:
        if self.address is not None and self.executor == "processes":
            raise ConfigError("--address", self.address, "no address with --executor processes")
        if self.executor == "processes":
            return False
        if not has_ray() and (self.executor == "ray" or self.address is not None):
            option = ("--executor", self.executor) if self.address is None else ("--address", self.address)
            raise ConfigError(*option, "Ray to be installed: pip install 'tel_ros[sweep]'")
        return has_ray()

    def __str__(self) -> str:
        if not self.with_ray:
            return f"{self.n_jobs} processes"
        return f"Ray at {self.address}" if self.address else f"Ray on {self.n_jobs} cores"

    def run(
        self, function: Callable[..., R], tasks: Mapping[K, tuple[Any, ...]]
    ) -> Generator[tuple[K, R | Failure], None, None]:
        """Call a function with each task's arguments; yield (key, result or failure) in order of completion.

        Close the generator to end the workers at once. Linear algebra runs on one thread: there is a worker
        for each core, and results do not depend on the number of cores.

        Raises:
            WorkersBrokenError: a worker process was killed, Ray does not start, or the cluster is gone.
        ModuleNotFoundError: the tasks need a module that is not installed.
        """
        if self.with_ray:
            yield from _on_ray(function, tasks, None if self.address else self.n_jobs, self.address)
        else:
            yield from _on_processes(function, tasks, self.n_jobs)


def has_ray() -> bool:
    return importlib.util.find_spec("ray") is not None


def _call(function: Callable[..., R], arguments: tuple[Any, ...]) -> R | Failure:
    from tel_ros.core.learning.least_squares import on_one_thread  # loads the linear algebra

    try:
        return on_one_thread(function)(*arguments)
    except ModuleNotFoundError:  # no task can do without it
        raise
    except TelError as error:  # as text: errors with arguments of their own cannot be pickled
        return Failure(str(error))
    except Exception as error:  # a fault in one task must not cost the others
        return Failure(f"{type(error).__name__}: {error}")


def _on_processes(
    function: Callable[..., R], tasks: Mapping[K, tuple[Any, ...]], jobs: int
) -> Generator[tuple[K, R | Failure], None, None]:
    # Not by fork: what the parent has loaded may have threads, and these do not survive it.
    context = multiprocessing.get_context("spawn")
    # The other end closes when this process ends, by whatever: then workers end, in the middle of their work.
    watched, held = context.Pipe(duplex=False)
    pool = ProcessPoolExecutor(jobs, context, initializer=_end_with, initargs=(watched,))
    try:
        futures = {pool.submit(_call, function, arguments): key for key, arguments in tasks.items()}
        for future in as_completed(futures):
            yield futures[future], future.result()
    except BrokenProcessPool:
        raise WorkersBrokenError("a worker process was killed (out of memory? try fewer --jobs)") from None
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


def _on_ray(
    function: Callable[..., R], tasks: Mapping[K, tuple[Any, ...]], jobs: int | None, address: str | None
) -> Generator[tuple[K, R | Failure], None, None]:
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    if address is None and "RAY_AUTH_MODE" not in os.environ:
        # Ray listens on all interfaces of the machine. Nobody else knows this token.
        os.environ["RAY_AUTH_MODE"] = "token"
        os.environ["RAY_AUTH_TOKEN"] = secrets.token_hex(32)
    import ray  # late: it is optional, and takes a second

    # Results are a few numbers: about the smallest store that Ray accepts.
    own = {"num_cpus": jobs, "include_dashboard": False, "object_store_memory": 80 * 2**20}
    given: dict[str, Any] = {} if address else own
    try:
        ray.init(address=address or "local", log_to_driver=False, logging_level=logging.ERROR, **given)
    except (ConnectionError, RuntimeError, ValueError) as error:
        where = f"at {address}" if address else "on this machine"
        raise WorkersBrokenError(f"no Ray {where}: {' '.join(str(error).split())}") from None
    # A worker that dies takes its task with it: that is tried elsewhere once.
    remote: Any = ray.remote(num_cpus=1, max_retries=1)(_call).remote
    waiting: dict[Any, K] = {}
    try:
        waiting.update((remote(function, arguments), key) for key, arguments in tasks.items())
        while waiting:
            ready, _ = ray.wait(list(waiting), num_returns=1)
            for reference in ready:
                try:
                    result = ray.get(reference)
                except ray.exceptions.RayTaskError as error:
                    if isinstance(error.cause, ModuleNotFoundError):
                        raise error.cause from None
                    result = Failure(f"{type(error.cause).__name__}: {error.cause}")
                except ray.exceptions.WorkerCrashedError:
                    result = Failure("the worker was killed (out of memory?)")
                yield waiting.pop(reference), result
    except ray.exceptions.RaySystemError as error:
        raise WorkersBrokenError(f"Ray broke down ({error})") from None
    finally:
        if address is not None:  # on a cluster they would go on
            for reference in waiting:
                ray.cancel(reference, force=True)
        ray.shutdown()
