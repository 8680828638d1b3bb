"""Who computes the points of a sweep: processes of this machine, or Ray, here or on a cluster.

Both give results as they come. However a sweep ends, even if it is killed, its workers end as well.
"""

from __future__ import annotations

import importlib.util
import logging
import os
import secrets
from collections.abc import Callable, Generator, Mapping
from concurrent.futures import Future, as_completed
from concurrent.futures.process import BrokenProcessPool
from typing import Any, Literal

from tel_lab.sweep.sweep_point import failure, run_point
from tel_lab.worker_pool import worker_pool
from tel_ros.core.config import Config
from tel_ros.core.errors import ConfigError, TelError

Results = Generator[tuple[str, dict[str, Any]], None, None]
Executor = Literal["auto", "ray", "processes"]

_RAY_STORE_BYTES = 80 * 2**20
"""Results are a few numbers: about the smallest store that Ray accepts."""


class SweepBrokenError(TelError):
    """The workers broke down; what was finished is kept."""


def has_ray() -> bool:
    """Return whether Ray is installed."""
    return importlib.util.find_spec("ray") is not None


def choose(executor: Executor, address: str | None) -> Literal["ray", "processes"]:
    """Return who is to compute: Ray where it is installed or an address asks for it.

    Raises:
        ConfigError: Ray is asked for and not installed, or processes are to be on a cluster.
    """
    if address is not None and executor == "processes":
        raise ConfigError("--address", address, "no address with --executor processes")
    if executor == "processes" or (executor == "auto" and address is None and not has_ray()):
        return "processes"
    if not has_ray():
        option, value = ("--executor", executor) if address is None else ("--address", address)
        raise ConfigError(option, value, "Ray to be installed: pip install 'tel_ros[sweep]'")
    return "ray"


def on_processes(points: Mapping[str, Config], jobs: int) -> Results:
    """Compute points on processes of this machine, as many at once as there are jobs.

    Raises:
        SweepBrokenError: a worker was killed.
    """
    with worker_pool(jobs) as pool:
        futures = {pool.submit(run_point, config): key for key, config in points.items()}
        for future in as_completed(futures):
            yield futures[future], _result_of(future)


def _result_of(future: Future[dict[str, Any]]) -> dict[str, Any]:
    try:
        return future.result()
    except BrokenProcessPool:
        raise SweepBrokenError(
            "a worker process was killed (out of memory? try fewer --jobs); the same command goes on"
        ) from None
    except Exception as error:  # a fault in one point must not cost the others
        return failure(f"{type(error).__name__}: {error}")


def on_ray(points: Mapping[str, Config], jobs: int | None, address: str | None) -> Results:
    """Compute points as Ray tasks of one core each.

    Args:
        points: hash of the configuration to configuration.
        jobs: how many at once on this machine; a cluster does as many as it has cores.
        address: of a cluster, as for ``ray.init``; None: Ray is started here, and ended afterwards.

    Raises:
        SweepBrokenError: Ray does not start, or the cluster is not there.
    """
    ray = _start_ray(jobs, address)
    # A worker that dies takes its point with it: that is tried elsewhere once.
    remote: Callable[[Config], Any] = ray.remote(num_cpus=1, max_retries=1)(run_point).remote
    waiting: dict[Any, str] = {}
    try:
        waiting.update((remote(config), key) for key, config in points.items())
        while waiting:
            ready, _ = ray.wait(list(waiting), num_returns=1)
            for reference in ready:
                yield waiting.pop(reference), _ray_result(ray, reference)
    except ray.exceptions.RaySystemError as error:
        raise SweepBrokenError(f"Ray broke down ({error}); the same command goes on") from None
    finally:
        if address is not None:  # on a cluster they would go on
            for reference in waiting:
                ray.cancel(reference, force=True)
        ray.shutdown()


def _start_ray(jobs: int | None, address: str | None) -> Any:
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    if address is None and "RAY_AUTH_MODE" not in os.environ:
        # Ray listens on all interfaces of the machine. Nobody else knows this token.
        os.environ["RAY_AUTH_MODE"] = "token"
        os.environ["RAY_AUTH_TOKEN"] = secrets.token_hex(32)
    import ray  # late: it is optional, and takes a second

    quiet: dict[str, Any] = {"log_to_driver": False, "logging_level": logging.ERROR}
    try:
        if address is None:
            ray.init(
                address="local",
                num_cpus=jobs,
                include_dashboard=False,
                object_store_memory=_RAY_STORE_BYTES,
                **quiet,
            )
        else:
            ray.init(address=address, **quiet)
    except (ConnectionError, RuntimeError, ValueError) as error:
        where = "on this machine" if address is None else f"at {address}"
        raise SweepBrokenError(f"no Ray {where}: {' '.join(str(error).split())}") from None
    return ray


def _ray_result(ray: Any, reference: Any) -> dict[str, Any]:
    try:
        result: dict[str, Any] = ray.get(reference)
    except ray.exceptions.RayTaskError as error:
        return failure(f"{type(error.cause).__name__}: {error.cause}")
    except ray.exceptions.WorkerCrashedError:
        return failure("the worker was killed (out of memory?)")
    return result
