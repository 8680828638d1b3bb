"""A sweep: practice runs over grids of configurations, in parallel, that goes on where it was interrupted."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import yaml

from tel_lab.sweep.sweep_folder import Row, SweepFolder
from tel_lab.sweep.sweep_plan import SweepPlan, SweepPoint, hash_of, lay_out
from tel_lab.sweep.sweep_workers import Executor, choose, on_processes, on_ray
from tel_ros import __version__
from tel_ros.core.config import Config
from tel_ros.core.errors import ConfigError
from tel_ros.recording.run_folder import write_atomically

SWEEP_FILE = "sweep.yaml"

Progress = Callable[[int, int], None]
"""Is told how many points are done, and of how many."""


@dataclass(frozen=True)
class Workforce:
    """Who computes.

    Args:
        executor: ``auto``: Ray where it is installed, else processes.
        jobs: how many points at once on this machine; None: one for each core that this process may use.
        address: of a Ray cluster, if it is not to be this machine.

    Raises:
        ConfigError: the values do not go together, or Ray is needed and not installed.
    """

    executor: Executor = "auto"
    jobs: int | None = None
    address: str | None = None

    def __post_init__(self) -> None:
        if self.jobs is not None and self.jobs < 1:
            raise ConfigError("--jobs", self.jobs, "a whole number of at least 1")
        if self.jobs is not None and self.address is not None:
            raise ConfigError("--jobs", self.jobs, "no --jobs with --address: a cluster has its own cores")
        choose(self.executor, self.address)

    @property
    def n_jobs(self) -> int:
        """How many points at once on this machine."""
        return self.jobs or len(os.sched_getaffinity(0))

    @property
    def name(self) -> str:
        """Who computes, for people."""
        if choose(self.executor, self.address) == "processes":
            return f"{self.n_jobs} processes"
        return f"Ray at {self.address}" if self.address else f"Ray on {self.n_jobs} cores"


class Sweep:
    """The points of a plan, and what is known of them.

    Args:
        config_file: configuration of the practice runs.
        plan: what to go through.
        out: folder of results; None: one named after the configuration and the points in ``bags/``, so that
            the same command finds it again.

    Raises:
        InputFileError: a file is missing or unreadable, or the folder cannot be used.
        ConfigError: a key is unknown, or a value fits no point.
    """

    def __init__(self, config_file: Path, plan: SweepPlan, out: Path | None = None) -> None:
        self.points = lay_out(config_file, plan)
        for point in self.points:
            if point.config is not None and point.config.run.arm != "sim":
                raise ConfigError("run.arm", point.config.run.arm, "'sim': a sweep is of simulated arms")
        self.folder = SweepFolder(out or default_folder(config_file, self.points))
        write_atomically(self.folder.path / SWEEP_FILE, _described(config_file, plan))

    @property
    def n_done(self) -> int:
        """How many points need not run."""
        return sum(point.config is None or self.folder.is_done(point.key) for point in self.points)

    def run(self, workforce: Workforce, progress: Progress = lambda done, total: None) -> None:
        """Compute the points that have no result yet or have failed, and keep each result as it comes.

        Raises:
            SweepBrokenError: the workers broke down; what was finished is kept.
        """
        todo: dict[str, Config] = {
            point.key: point.config
            for point in self.points
            if point.config is not None and not self.folder.is_done(point.key)
        }
        total = len({point.key for point in self.points})
        done = total - len(todo)
        progress(done, total)
        if not todo:
            return
        if choose(workforce.executor, workforce.address) == "ray":
            jobs = None if workforce.address else workforce.n_jobs
            results = on_ray(todo, jobs, workforce.address)
        else:
            results = on_processes(todo, workforce.n_jobs)
        try:
            for key, result in results:
                self.folder.keep(key, result)
                done += 1
                progress(done, total)
        finally:
            results.close()  # ends the workers at once, also on Ctrl-C

    def rows(self) -> list[Row]:
        """Return the table: a row for each point that has a result, in the order of the plan."""
        return self.folder.rows(self.points)


def default_folder(config_file: Path, points: Sequence[SweepPoint]) -> Path:
    """Return where the results of these points go if nobody says where."""
    return Path("bags") / f"sweep-{config_file.stem}-{hash_of([point.key for point in points])[:8]}"


def _described(config_file: Path, plan: SweepPlan) -> str:
    """Return as YAML what was asked for, to read later."""
    asked = {
        "tel_ros": __version__,
        "config": config_file.name,
        "overrides": list(plan.overrides),
        "cases": {name: list(changes) for name, changes in plan.cases.items()},
        "grid": {key: list(values) for key, values in plan.grid.items()},
        "seeds": plan.seeds,
    }
    return str(yaml.safe_dump(asked, sort_keys=False, allow_unicode=True))
