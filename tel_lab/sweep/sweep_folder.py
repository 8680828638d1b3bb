"""The folder of a sweep: a small file for each finished point, and the table that is made of them."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from tel_lab.sweep.sweep_plan import SweepPoint
from tel_lab.sweep.sweep_point import FAILED, MEASURES, failure
from tel_ros.core.errors import InputFileError
from tel_ros.recording.run_folder import write_atomically

TABLE_CSV = "table.csv"
TABLE_PARQUET = "table.parquet"
_POINTS = "points"

Row = dict[str, Any]


class SweepFolder:
    """Results by the hash of their configuration; a result that is there is whole.

    Args:
        path: the folder; is made if it does not exist.

    Raises:
        InputFileError: it is no folder, or must not be written to.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._points = path / _POINTS
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
        """Return whether a point need not run: it has a result, and not one of having failed at once.

        What fails before the first trial may have failed because of the machine; what fails later would
        fail again.
        """
        result = self.result(key)
        return result is not None and (result["outcome"] != FAILED or result["trials"] is not None)

    def keep(self, key: str, result: Mapping[str, Any]) -> None:
        """Write the result of a point; after that it survives whatever happens to the sweep."""
        write_atomically(self._points / f"{key}.json", json.dumps(result, allow_nan=False) + "\n")

    def rows(self, points: Sequence[SweepPoint]) -> list[Row]:
        """Return a row for each of these points that has a result, in their order."""
        rows = []
        for point in points:
            result = self.result(point.key) if point.config else failure(point.problem)
            if result is not None:
                measures = {name: result[name] for name in MEASURES}
                rows.append({**point.labels, **measures, "config_hash": point.key})
        return rows

    def write_table(self, rows: Sequence[Row]) -> list[Path]:
        """Write the table as CSV, and as Parquet where pyarrow is installed; return the files."""
        flat = [{name: _cell(value) for name, value in row.items()} for row in rows]
        text = io.StringIO()
        if flat:
            writer = csv.DictWriter(text, list(flat[0]), lineterminator="\n")
            writer.writeheader()
            writer.writerows(flat)
        write_atomically(self.path / TABLE_CSV, text.getvalue())
        files = [self.path / TABLE_CSV]
        if flat and _write_parquet(self.path / TABLE_PARQUET, flat):
            files.append(self.path / TABLE_PARQUET)
        return files


def _cell(value: Any) -> Any:
    """Return a value as one cell can hold it: lists, as of values for each joint, become text."""
    return json.dumps(value) if isinstance(value, list | dict) else value


def _write_parquet(path: Path, rows: list[Row]) -> bool:
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:  # optional: there is the CSV
        return False
    beside = path.with_name(f".{path.name}.tmp")
    pyarrow.parquet.write_table(pyarrow.Table.from_pylist(rows), beside)
    beside.replace(path)
    return True
