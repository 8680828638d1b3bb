"""Tables on the terminal, and in logs."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from typing import Any

from rich import box
from rich.console import Console
from rich.table import Table

NOTHING = "–"


def simple_table(*headings: str, left: Collection[str]) -> Table:
    """Return an empty table; columns are aligned to the right unless their headings are in ``left``."""
    table = Table(box=box.SIMPLE_HEAD)
    for heading in headings:
        style: dict[str, Any] = {"overflow": "fold"} if heading in left else {"justify": "right"}
        table.add_column(heading, **style)
    return table


def show(table: Table) -> None:
    """Print a table on stdout."""
    console = Console()
    if not console.is_terminal:
        console.width = 160
    console.print(table)


def compact_table(*headings: str) -> Table:
    """Return an empty table that fits 80 columns; the last column is aligned to the left."""
    table = Table(box=box.SIMPLE_HEAD, header_style="bold", padding=(0, 1), pad_edge=False)
    for heading in headings:
        table.add_column(heading, justify="left" if heading in ("bag", headings[-1]) else "right")
    return table


def trial_table(trials: Sequence[Mapping[str, Any]]) -> Table:
    """Return the trials of a summary as a table."""
    errors = ("RMS error\nrad", "max error\nrad", "training error\nbefore → after rad")
    table = compact_table("trial", "α", "duration\ns", *errors, "outcome")
    for trial in trials:
        table.add_row(
            str(trial["index"]),
            f"{trial['alpha']:.3f}",
            f"{trial['duration_s']:.3f}",
            fixed(trial["rms_error_rad"], 4),
            fixed(trial["max_error_rad"], 4),
            training_error(trial),
            trial["outcome"],
        )
    return table


def fixed(value: float | None, decimals: int) -> str:
    """Return a number for a column; a dash for None and what is not finite."""
    return NOTHING if value is None or not math.isfinite(value) else f"{value:.{decimals}f}"


def training_error(trial: Mapping[str, Any]) -> str:
    """Return the training error of a row of a summary before and after training."""
    return f"{fixed(trial['training_rms_before_rad'], 4)} → {fixed(trial['training_rms_after_rad'], 4)}"
