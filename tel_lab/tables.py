"""What goes into pages: tables, whose columns are declared once, texts from templates, and figures."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from rich import box
from rich.table import Table as TerminalTable
from rich.text import Text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Row = TypeVar("Row")

NONE = "–"


@dataclass(frozen=True)
class Column(Generic[Row]):
    """A column of a table.

    Args:
        heading: with the unit.
        value: of a row.
        form: a format specification (".2f"), or what turns a value into text. None and NaN become a dash.
        left: whether it holds words: left-aligned.
        key: its name in CSV; empty: the heading.
    """

    heading: str
    value: Callable[[Row], Any]
    form: str | Callable[[Any], str] = ""
    left: bool = False
    key: str = ""

    def text(self, row: Row) -> str:
        value = self.value(row)
        if value is None or (isinstance(value, float) and math.isnan(value)):
            return NONE
        return self.form(value) if callable(self.form) else format(value, self.form)


@dataclass(frozen=True)
class Table(Generic[Row]):
    """Rows below columns; the title is for the terminal."""

    columns: Sequence[Column[Row]]
    rows: Sequence[Row] = field(default_factory=list)
    title: str = ""

    def cells(self) -> list[list[str]]:
        return [[column.text(row) for column in self.columns] for row in self.rows]

    def markdown(self) -> str:
        """Return the table for a page; columns line up as text, too."""
        cells = [[column.heading for column in self.columns], *self.cells()]
        lines = [[text.replace("|", r"\|") for text in line] for line in cells]
        widths = [max(3, *(len(line[j]) for line in lines)) for j in range(len(self.columns))]
        last = len(widths) - 1

        def padded(line: Sequence[str]) -> str:
            cells = [
                (text if j == last else text.ljust(width)) if column.left else text.rjust(width)
                for j, (text, width, column) in enumerate(zip(line, widths, self.columns, strict=True))
            ]
            return f"| {' | '.join(cells)} |"

        rule = [
            "-" * (3 if c.left and j == last else w) if c.left else "-" * (w - 1) + ":"
            for j, (w, c) in enumerate(zip(widths, self.columns, strict=True))
        ]
        return "\n".join([padded(lines[0]), f"| {' | '.join(rule)} |", *map(padded, lines[1:])])

    def terminal(self) -> TerminalTable:
        """Return the table for a terminal (rich)."""
        table = TerminalTable(title=self.title or None, title_justify="left", box=box.SIMPLE_HEAD)
        for column in self.columns:
            table.add_column(Text(column.heading), justify="left" if column.left else "right")
        for line in self.cells():
            table.add_row(*map(Text, line))
        return table

    def csv(self) -> str:
        """Return the values as CSV: numbers in full, empty where there is none."""
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow([column.key or column.heading for column in self.columns])
        for row in self.rows:
            values = [column.value(row) for column in self.columns]
            writer.writerow(["" if isinstance(v, float) and math.isnan(v) else v for v in values])
        return text.getvalue()


def of_texts(headings: Sequence[str], lines: Iterable[Sequence[str]], n_words: int = 1) -> Table[Any]:
    """Return a table of texts that are there already; the first ``n_words`` columns are left-aligned."""

    def column(j: int, heading: str) -> Column[Sequence[str]]:
        return Column(heading, lambda line: line[j], left=j < n_words)

    return Table([column(j, heading) for j, heading in enumerate(headings)], list(lines))


def filled(page: str, **values: Any) -> str:
    """Return the text of a page (``NAME.md``) from its template in ``tel_lab/pages``."""
    from jinja2 import Environment, PackageLoader, StrictUndefined  # late: an extra

    loader = PackageLoader("tel_lab", "pages")
    templates = Environment(loader=loader, undefined=StrictUndefined, trim_blocks=True)  # noqa: S701
    text: str = templates.get_template(f"{page}.j2").render(**values)
    return text.rstrip("\n") + "\n"


def write_figure(
    draw: Callable[[], Figure], path: Path, formats: Sequence[str] = ("svg", "png")
) -> list[Path]:
    """Draw a figure in the common style and write it in some formats (svg, png, pdf); return the files."""
    from tel_ros.app.plotting import figure_style, save_figure  # late: plotting takes a second to import

    path.parent.mkdir(parents=True, exist_ok=True)
    files = [path.with_suffix(f".{kind}") for kind in formats]
    with figure_style(path.name):
        figure = draw()
        for file in files:
            save_figure(figure, file)
    return files
