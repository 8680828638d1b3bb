"""A figure of a report: on the page, and as files beside it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FIGURE_FOLDER = "figures"
FIGURE_FORMATS = ("png", "svg", "pdf")


@dataclass(frozen=True)
class ReportFigure:
    """A figure on the page.

    Args:
        svg: the element to put into the page; empty if there is nothing to draw.
        caption: what it shows, or why it is missing.
        files: names of its files, as a reader of the page finds them.
    """

    svg: str
    caption: str
    files: str = ""


class FigureMaker:
    """Draws the figures of one page.

    Args:
        folder: of the page; the files go into a folder below it.
        formats: of the files, of :data:`FIGURE_FORMATS`.
    """

    def __init__(self, folder: Path, formats: Sequence[str]) -> None:
        self._folder = folder / FIGURE_FOLDER
        self._formats = tuple(formats)

    def make(self, name: str, draw: Callable[[], Figure], caption: str) -> ReportFigure:
        """Draw a figure and write its files.

        Args:
            name: of the files, without their endings.
            draw: makes the figure.
            caption: what it shows.
        """
        from markupsafe import Markup

        from tel_ros.app.figure_export import figure_style, inline_svg, save_figure

        self._folder.mkdir(exist_ok=True)
        with figure_style(name):
            figure = draw()
            for kind in self._formats:
                save_figure(figure, self._folder / f"{name}.{kind}")
            # All is in its place; to find it again takes longer than to draw.
            figure.set_layout_engine("none")
            svg = inline_svg(figure, name)
        self._remove(name, but=self._formats)
        first, *others = self._formats
        files = ", ".join([f"{FIGURE_FOLDER}/{name}.{first}", *(f".{kind}" for kind in others)])
        return ReportFigure(Markup(svg), caption, files)

    def missing(self, name: str, why: str) -> ReportFigure:
        """Return what stands in place of a figure that cannot be drawn."""
        self._remove(name, but=())
        return ReportFigure("", why)

    def _remove(self, name: str, but: Sequence[str]) -> None:
        """Remove the files of an earlier report: they would pass for some of this one."""
        for kind in set(FIGURE_FORMATS) - set(but):
            (self._folder / f"{name}.{kind}").unlink(missing_ok=True)
