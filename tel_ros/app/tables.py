"""Tables on the terminal, and in logs."""

from __future__ import annotations

from collections.abc import Collection

from rich import box
from rich.console import Console
from rich.table import Table

_LOG_WIDTH = 160
"""Where there is no terminal whose width could be asked for."""


def simple_table(*headings: str, left: Collection[str]) -> Table:
    """Return an empty table; columns are aligned to the right unless their headings are in ``left``."""
    table = Table(box=box.SIMPLE_HEAD)
    for heading in headings:
        if heading in left:
            table.add_column(heading, overflow="fold")
        else:
            table.add_column(heading, justify="right")
    return table


def show(table: Table) -> None:
    """Print a table on stdout."""
    console = Console()
    if not console.is_terminal:
        console.width = _LOG_WIDTH
    console.print(table)
