"""A sweep: practice runs over grids of configurations, in parallel, that goes on where it was interrupted."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from importlib.util import find_spec
from operator import itemgetter
from pathlib import Path
from typing import Any

import yaml

from tel_lab.sweep.plan import SweepPlan, hash_of, lay_out
from tel_lab.sweep.point import FAILED, MEASURES, failure, run_point
from tel_lab.tables import Column, Table
from tel_lab.workers import Failure, Workforce
from tel_ros import __version__
from tel_ros.core.errors import ConfigError, InputFileError, TelError
from tel_ros.recording.config_file import read_yaml
from tel_ros.recording.run_folder import write_atomically

Row = dict[str, Any]


class SweepFolder:
    """Results by the hash of their configuration; a result that is there is whole.

    The folder is made if it does not exist; InputFileError if it is none, or must not be written to.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._points = path / "points"
        try:
            self._points.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputFileError(path, f"not usable ({error.strerror})", "a folder (option --out)") from None

    def result(self, key: str) -> Row | None:
        """Return the result of a point; None if there is none that can be read and has all measures."""
        try:
            result = json.loads((self._points / f"{key}.json").read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return None
        return result if isinstance(result, dict) and set(MEASURES) <= set(result) else None

    def is_done(self, key: str) -> bool:
        """Return whether a point need not run: it has a result, and did not fail before its first trial.

        What fails before the first trial may have failed because of the machine; what fails later would
        fail again.
        """
        result = self.result(key)
        return result is not None and (result["outcome"] != FAILED or result["trials"] is not None)

    def keep(self, key: str, result: Mapping[str, Any]) -> None:
        """Write the result of a point; it survives whatever happens to the sweep."""
        write_atomically(self._points / f"{key}.json", json.dumps(result, allow_nan=False) + "\n")

    def write_table(self, rows: Sequence[Row]) -> list[Path]:
        """Write the table as CSV, and as Parquet where pyarrow is installed; return the files."""
        # Lists, as of values for each joint, become text: one cell holds them.
        flat = [{k: json.dumps(v) if isinstance(v, list | dict) else v for k, v in r.items()} for r in rows]
        csv_file, parquet_file = self.path / "table.csv", self.path / "table.parquet"
        columns = [Column(key, itemgetter(key)) for key in flat[0]] if flat else []
        write_atomically(csv_file, Table(columns, flat).csv() if flat else "")
        if not flat or find_spec("pyarrow") is None:  # it is optional
            return [csv_file]
        import pyarrow
        import pyarrow.parquet

        beside = parquet_file.with_name(f".{parquet_file.name}.tmp")
        pyarrow.parquet.write_table(pyarrow.Table.from_pylist(flat), beside)
        beside.replace(parquet_file)
        return [csv_file, parquet_file]


def _points_of(folder: Path) -> str:
    """Return what tells the sweep in a folder from others; empty if there is none."""
    try:
        return str(read_yaml(folder / "sweep.yaml").get("points"))
    except TelError:
        return ""


class Sweep:
    """The points of a plan, and what is known of them.

    The folder of results, if none is given, is one in ``bags/`` named after the configuration and the points,
    so that the same command finds it again.

    Raises:
        InputFileError: a file is missing or unreadable, or the folder cannot be used or holds something else.
        ConfigError: a key is unknown, or a value fits no point.
    """

    def __init__(self, config_file: Path, plan: SweepPlan, out: Path | None = None) -> None:
        self.points = lay_out(config_file, plan)
        for point in self.points:
            if point.config is not None and point.config.run.arm != "sim":
                raise ConfigError("run.arm", point.config.run.arm, "'sim': a sweep is of simulated arms")
        points = hash_of([point.key for point in self.points])
        folder = out or Path("bags") / f"sweep-{config_file.stem}-{points[:8]}"
        if folder.is_dir() and any(folder.iterdir()) and _points_of(folder) != points:
            found = "holds another sweep" if (folder / "sweep.yaml").is_file() else "is not empty"
            raise InputFileError(folder, found, "a new folder, or that of the same sweep (option --out)")
        self.folder = SweepFolder(folder)
        asked = {"tel_ros": __version__, "config": config_file.name, **plan.plain(), "points": points}
        text = yaml.safe_dump(asked, sort_keys=False, allow_unicode=True)
        write_atomically(self.folder.path / "sweep.yaml", text)

    @property
    def n_done(self) -> int:
        return sum(point.config is None or self.folder.is_done(point.key) for point in self.points)

    def run(self, workforce: Workforce, progress: Callable[[int, int], None]) -> None:
        """Compute the points that have no result yet or have failed, and keep each result as it comes.

        ``progress`` is told how many points are done, and of how many.

        Raises:
            WorkersBrokenError: the workers broke down; what was finished is kept.
        """
        todo = {
            point.key: (point.config,)
            for point in self.points
            if point.config is not None and not self.folder.is_done(point.key)
        }
        total = len({point.key for point in self.points})
        done = total - len(todo)
        progress(done, total)
        if not todo:
            return
        with closing(workforce.run(run_point, todo)) as results:  # ends the workers at once, also on Ctrl-C
            for key, result in results:
                self.folder.keep(key, failure(result.message) if isinstance(result, Failure) else result)
                done += 1
                progress(done, total)

    def rows(self) -> list[Row]:
        """Return the table: a row for each point that has a result, in the order of the plan."""
        rows = []
        for point in self.points:
            result = self.folder.result(point.key) if point.config else failure(point.problem)
            if result is not None:
                measures = {name: result[name] for name in MEASURES}
                rows.append({**point.labels, **measures, "config_hash": point.key})
        return rows
