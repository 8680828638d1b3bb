"""A table is declared once and reads the same on a page, in a terminal and as CSV."""

from __future__ import annotations

import io
import math
from pathlib import Path

from matplotlib.figure import Figure
from rich.console import Console

from tel_lab.tables import Column, Table, of_texts, write_figure

TABLE = Table(
    [
        Column("arm", lambda row: row[0], left=True, key="arm"),
        Column("error [mrad]", lambda row: 1e3 * row[1], ".2f", key="error_mrad"),
        Column("outcome", lambda row: row[2], left=True),
    ],
    [("light", 0.00512, "completed"), ("heavy", math.nan, "a|b, long")],
)


def test_markdown_lines_up_and_numbers_are_on_the_right() -> None:
    assert TABLE.markdown().splitlines() == [
        "| arm   | error [mrad] | outcome |",
        "| ----- | -----------: | --- |",
        "| light |         5.12 | completed |",
        r"| heavy |            – | a\|b, long |",
    ]


def test_csv_has_the_numbers_in_full_and_nothing_where_there_is_none() -> None:
    assert TABLE.csv() == 'arm,error_mrad,outcome\nlight,5.12,completed\nheavy,,"a|b, long"\n'


def test_a_terminal_shows_units_in_brackets() -> None:
    console = Console(file=io.StringIO(), width=80)
    console.print(TABLE.terminal())
    assert "error [mrad]" in console.file.getvalue()  # type: ignore[attr-defined]
    assert "5.12" in console.file.getvalue()  # type: ignore[attr-defined]


def test_texts_that_are_there_already_make_a_table() -> None:
    table = of_texts(("a", "b"), [("x", "1")])
    assert table.markdown() == "| a   |   b |\n| --- | --: |\n| x   |   1 |"


def test_equal_figures_give_equal_files(tmp_path: Path) -> None:
    def draw() -> Figure:
        figure = Figure()
        figure.subplots().plot([1.0, 2.0], label="line")
        return figure

    first = [file.read_bytes() for file in write_figure(draw, tmp_path / "new" / "map")]
    assert first == [file.read_bytes() for file in write_figure(draw, tmp_path / "new" / "map")]
    assert {file.name for file in (tmp_path / "new").iterdir()} == {"map.png", "map.svg"}
