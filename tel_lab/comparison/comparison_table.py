"""The results of a comparison as text: for the terminal, as CSV, as JSON and as a page of Markdown."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any

from tel_lab.comparison.method_runs import Comparison
from tel_lab.comparison.results import COLUMNS, MeritColumn, MethodRun
from tel_lab.comparison.statistics import Median, median, standing
from tel_lab.tables import Column, Table, filled, of_texts, write_figure
from tel_ros.core.errors import InputFileError
from tel_ros.recording.run_folder import json_ready

GIVEN_MARK: dict[str, str] = {"nothing": "", "kinematics": " ¹", "urdf": " ²", "model": " ³"}
GIVEN_NOTE = (
    "¹ is told the kinematics of the arm, ² the inertias and frictions of its URDF as well, ³ the true ones. "
    "All others are told K and B alone."
)
NONE, NEVER = "–", "never"
NAME = "comparison"


def values(comparison: Comparison, column: MeritColumn, method: str) -> list[float]:
    """Return one column of one method, in the order of the seeds."""
    return [column.value(run) for run in comparison.runs[method]]


def middle(comparison: Comparison, column: MeritColumn, method: str) -> Median | None:
    """Return the median over the arms; None if the method has no such value."""
    found = values(comparison, column, method)
    return None if any(map(math.isnan, found)) else median(found)


def number(value: float, column: MeritColumn) -> str:
    """Return a value as it stands in tables: three digits that count, angles in mrad."""
    if math.isinf(value):
        return "aborted" if column.in_mrad else NEVER
    shown = 1e3 * value if column.in_mrad else value
    return f"{shown:.0f}" if shown >= 100.0 or shown == round(shown) else f"{shown:.3g}"


def cell(found: Median | None, column: MeritColumn) -> str:
    """Return a median with its interval in brackets; without one where there are too few arms for it."""
    if found is None:
        return NONE
    middle_text = number(found.value, column)
    if math.isnan(found.low) or found.low == found.high:
        return middle_text
    return f"{middle_text} [{number(found.low, column)}, {number(found.high, column)}]"


def heading(column: MeritColumn) -> str:
    return f"{column.title} [mrad]" if column.in_mrad else column.title


def rows(comparison: Comparison) -> Iterator[list[str]]:
    for spec in comparison.methods:
        cells = [cell(middle(comparison, column, spec.name), column) for column in COLUMNS]
        yield [spec.title + GIVEN_MARK[spec.given], *cells]


def table(comparison: Comparison) -> Table[list[str]]:
    return of_texts(["method", *map(heading, COLUMNS)], rows(comparison))


def csv_text(comparison: Comparison) -> str:
    """Return one line a method and arm; angles in rad, ``inf`` for never and aborted, empty for none."""

    def figure(column: MeritColumn) -> Column[MethodRun]:
        return Column(column.key, lambda run: f"{column.value(run):.6g}".replace("nan", ""))

    columns: list[Column[MethodRun]] = [
        Column("method", lambda run: run.method),
        Column("seed", lambda run: run.seed),
        *map(figure, COLUMNS),
        Column("trials", lambda run: len(run.trials)),
        Column("arm_s", lambda run: f"{run.arm_s:.3f}"),
        Column("message", lambda run: run.message),
    ]
    return Table(columns, [run for spec in comparison.methods for run in comparison.runs[spec.name]]).csv()


def json_text(comparison: Comparison) -> str:
    """Return everything as JSON: null for never, aborted and none."""

    def record(run: MethodRun) -> dict[str, Any]:
        return {
            **dataclasses.asdict(run),
            **{column.key: column.value(run) for column in COLUMNS},
            "arm_s": run.arm_s,
        }

    methods = {}
    for spec in comparison.methods:
        medians = {column.key: middle(comparison, column, spec.name) for column in COLUMNS}
        methods[spec.name] = {
            "title": spec.title,
            "given": spec.given,
            "median": {key: found and dataclasses.asdict(found) for key, found in medians.items()},
            "runs": [record(run) for run in comparison.runs[spec.name]],
        }
    speed = {"arm_s": comparison.arm_s, "wall_s": comparison.wall_s, "cpu_s": comparison.cpu_s}
    return json.dumps(json_ready({"methods": methods, "speed": speed}), indent=2, allow_nan=False)


def standings(comparison: Comparison, family: str) -> Iterator[list[str]]:
    """Yield a row a method of a family: its title, and where it stands in each column.

    It is compared with the methods outside the family that are told no more than it is. Names of methods of a
    family begin with its name.
    """
    titles = {spec.name: spec.title for spec in comparison.methods}
    for spec in comparison.methods:
        if not spec.name.startswith(family):
            continue
        told = [*GIVEN_MARK][: [*GIVEN_MARK].index(spec.given) + 1]
        rivals = [s.name for s in comparison.methods if s.given in told and not s.name.startswith(family)]
        row = [spec.title + GIVEN_MARK[spec.given]]
        for column in COLUMNS:
            known = [name for name in rivals if middle(comparison, column, name) is not None]
            among = {name: values(comparison, column, name) for name in (spec.name, *known)}
            where = standing(spec.name, among)
            row.append(where.rank + (f": {titles[where.rivals[0]]}" if where.rivals else ""))
        yield row


def speed_text(comparison: Comparison) -> str:
    arm_s, wall_s = comparison.arm_s, comparison.wall_s
    return (
        f"{arm_s:.0f} s of arm time in {wall_s:.0f} s: {arm_s / wall_s:.0f} times real time "
        f"({arm_s / comparison.cpu_s:.0f} times for a core that does nothing else)"
    )


def page(comparison: Comparison, command: str, figure: str) -> str:
    runs = comparison.runs[comparison.methods[0].name]
    return filled(
        f"{NAME}.md",
        command=command,
        n_arms=len(runs),
        tolerance=f"{1e3 * runs[0].tolerance_rad:g} mrad RMS at {runs[0].goal_duration_s:g} s",
        table=table(comparison).markdown(),
        given_note=GIVEN_NOTE,
        never=NEVER,
        figure=figure,
        places=of_texts(["", *(c.title for c in COLUMNS)], standings(comparison, "tel_adaptive")).markdown(),
        methods=comparison.methods,
        speed=speed_text(comparison),
    )


@contextmanager
def writing_to(folder: Path) -> Iterator[None]:
    """Make a folder and try it; InputFileError if it cannot be written to."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with TemporaryFile(dir=folder):
            yield
    except OSError as error:
        found = f"cannot be written to ({error.strerror})"
        raise InputFileError(folder, found, "a folder of your own") from None


def write_files(comparison: Comparison, folder: Path, command: str) -> None:
    """Write comparison.csv, .json, .md, .svg and .png into a folder; files of these names are replaced.

    Raises:
        InputFileError: the folder cannot be written to.
    """
    from tel_lab.comparison.comparison_figure import comparison_figure  # late: plotting takes a second

    texts = {
        "csv": csv_text(comparison),
        "json": json_text(comparison) + "\n",
        "md": page(comparison, command, f"{NAME}.svg"),
    }
    with writing_to(folder):
        for suffix, text in texts.items():
            (folder / f"{NAME}.{suffix}").write_text(text, encoding="utf-8")
        write_figure(lambda: comparison_figure(comparison), folder / NAME)
