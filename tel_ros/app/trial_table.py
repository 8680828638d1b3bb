"""The trials of a run as a table in the terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from rich import box
from rich.table import Table


def trial_table(trials: Sequence[Mapping[str, Any]]) -> Table:
    """Return the trials of a summary as a table that fits 80 columns."""
    table = Table(box=box.SIMPLE_HEAD, header_style="bold", padding=(0, 1), pad_edge=False)
    table.add_column("trial", justify="right")
    table.add_column("α", justify="right")
    table.add_column("duration\ns", justify="right")
    table.add_column("RMS error\nrad", justify="right")
    table.add_column("max error\nrad", justify="right")
    table.add_column("training error\nbefore → after rad", justify="right")
    table.add_column("outcome")
    for trial in trials:
        table.add_row(
            str(trial["index"]),
            f"{trial['alpha']:.3f}",
            f"{trial['duration_s']:.3f}",
            number(trial["rms_error_rad"]),
            number(trial["max_error_rad"]),
            f"{number(trial['training_rms_before_rad'])} → {number(trial['training_rms_after_rad'])}",
            trial["outcome"],
        )
    return table


def number(value: float | None) -> str:
    """Return a number as it stands in tables; None: there is none."""
    return "–" if value is None else f"{value:.4f}"
