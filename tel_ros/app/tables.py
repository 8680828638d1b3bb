"""Tables on the terminal, and in logs."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

NOTHING = "–"
TRAINING_ERROR = "training error\nbefore → after\nrad"


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


def trial_table(trials: Iterable[Mapping[str, Any]]) -> Table:
    """Return the trials of a summary as a table."""
    headings = ("trial", "α", "duration\ns", "RMS error\nrad", "max error\nrad", TRAINING_ERROR, "outcome")
    rows = [
        (
            str(trial["index"]),
            fixed(trial["alpha"], 3),
            fixed(trial["duration_s"], 3),
            fixed(trial["rms_error_rad"], 4),
            fixed(trial["max_error_rad"], 4),
            training_error(trial),
            trial["outcome"] + (f": {trial['message']}" if trial["message"] else ""),
        )
        for trial in trials
    ]
    return table(headings, rows, left=("outcome",))


def fixed(value: float | None, decimals: int) -> str:
    """Return a number for a column; a dash for None and what is not finite."""
    return NOTHING if value is None or not math.isfinite(value) else f"{value:.{decimals}f}"


def training_error(trial: Mapping[str, Any]) -> str:
    """Return the training error of a row of a summary before and after training."""
    return f"{fixed(trial['training_rms_before_rad'], 4)} → {fixed(trial['training_rms_after_rad'], 4)}"
