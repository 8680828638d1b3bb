"""Tables on the terminal, and in logs."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

NOTHING = "–"
_OF_TRIAL: dict[str, Callable[[Mapping[str, Any]], str]] = {
    "bag": lambda row: Path(row["bag"]).name,
    "trial": lambda row: str(row["index"]),
    "path": lambda row: row["path"] or NOTHING,
    "α": lambda row: fixed(row["alpha"], 3),
    "duration\ns": lambda row: fixed(row["duration_s"], 3),
    "RMS error\nrad": lambda row: fixed(row["rms_error_rad"], 4),
    "max error\nrad": lambda row: fixed(row["max_error_rad"], 4),
    "training error\nbefore → after\nrad": lambda row: " → ".join(
        fixed(row[f"training_rms_{when}_rad"], 4) for when in ("before", "after")
    ),
    "outcome": lambda row: row["outcome"] + (f": {row['message']}" if row.get("message") else ""),
}
"""Heading to what a row of a summary has below it."""


def table(headings: Iterable[str], rows: Iterable[Sequence[str | Text]], left: Collection[str] = ()) -> Table:
    """Return a table that cuts nothing off; columns are aligned to the right unless ``left`` names them."""
    made = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for heading in headings:
        made.add_column(heading, overflow="fold", justify="left" if heading in left else "right")
    for row in rows:
        made.add_row(*(Text(cell) if isinstance(cell, str) else cell for cell in row))  # brackets, too
    return made


def show(*shown: Table | str) -> None:
    """Print tables and lines on stdout; where that is no terminal, nothing is wrapped."""
    console = Console()
    if not console.is_terminal:
        console.width = 10_000
    for each in shown:
        console.print(each, highlight=False, markup=False, soft_wrap=isinstance(each, str))


def trial_table(trials: Sequence[Mapping[str, Any]], without: Collection[str] = ("bag",)) -> Table:
    """Return rows of a summary as a table."""
    if not any(trial.get("path") for trial in trials):
        without = {*without, "path"}
    shown = {heading: cell for heading, cell in _OF_TRIAL.items() if heading not in without}
    rows = [[cell(trial) for cell in shown.values()] for trial in trials]
    return table(shown, rows, ("bag", "path", "outcome"))


def fixed(value: float | None, decimals: int) -> str:
    """Return a number for a column; a dash for None and what is not finite."""
    return NOTHING if value is None or not math.isfinite(value) else f"{value:.{decimals}f}"
