"""The files of a comparison."""

from __future__ import annotations

from pathlib import Path

from tel_lab.comparison.comparison_figure import comparison_figure
from tel_lab.comparison.comparison_table import csv_text, json_text, page
from tel_lab.comparison.method_runs import Comparison
from tel_ros.app.plotting import figure_style, save_figure
from tel_ros.core.errors import InputFileError

NAME = "comparison"


def write_files(comparison: Comparison, folder: Path, command: str) -> None:
    """Write comparison.csv, .json, .md, .svg and .png into a folder; files of these names are replaced.

    Args:
        comparison: all results.
        folder: is made if it is missing.
        command: what made it, for the page.

    Raises:
        InputFileError: the folder cannot be written to.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        texts = {
            "csv": csv_text(comparison),
            "json": json_text(comparison) + "\n",
            "md": page(comparison, command, f"{NAME}.svg"),
        }
        for suffix, text in texts.items():
            (folder / f"{NAME}.{suffix}").write_text(text, encoding="utf-8")
        with figure_style(NAME):
            figure = comparison_figure(comparison)
            for kind in ("svg", "png"):
                save_figure(figure, folder / f"{NAME}.{kind}")
    except OSError as error:
        raise InputFileError(
            folder, f"cannot be written to ({error.strerror})", "a folder of your own"
        ) from None
