"""A report as a list of sections, and the page that they make up."""

from __future__ import annotations

import errno
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, TypeVar

from markupsafe import Markup
from matplotlib.figure import Figure

from tel_ros.app.plotting import PALETTE, figure_style, inline_svg, save_figure
from tel_ros.app.report import text
from tel_ros.app.report.command import FIGURE_FORMATS
from tel_ros.app.tables import fixed
from tel_ros.app.templates import template
from tel_ros.core.errors import InputFileError
from tel_ros.recording.run_folder import REPORT_FILE, write_atomically

FIGURE_FOLDER = "figures"
Data = TypeVar("Data")


@dataclass(frozen=True)
class Content:
    """What a section shows: a figure, its caption (or why there is none), and HTML that follows."""

    figure: Figure | None = None
    caption: str = ""
    html: Markup = Markup()


@dataclass(frozen=True)
class Section(Generic[Data]):
    """A part of a report; ``id`` is its place on the page."""

    id: str
    title: str
    content: Callable[[Data], Content | Figure | None]
    """Makes what it shows, in the style of the figures; None: the section is left out."""
    file: str = ""
    """Name of the figure's files, without ending; empty: the section never has a figure."""
    caption: str = ""
    """Of a figure that comes without one."""
    of_movements: bool = False
    """Whether ``data.why_not_drawn``, if it is not empty, stands in place of its content."""


def write_page(
    folder: Path, sections: Sequence[Section[Data]], data: Data, formats: Sequence[str], **head: str
) -> Path:
    """Write ``report.html`` and the figures of all sections into a folder, and return the page's path.

    Figures of an earlier report in other formats are removed. ``head`` is ``title``, ``header`` and
    ``footer`` of the page. InputFileError if something cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        made = [each for section in sections if (each := _made(folder, section, data, formats)) is not None]
        html = template("page.html.j2").render(head, sections=made, palette=PALETTE)
        write_atomically(folder / REPORT_FILE, html + "\n")
    except OSError as error:
        problem = "is a file" if error.errno == errno.EEXIST else f"cannot be written ({error.strerror})"
        raise InputFileError(error.filename or folder, problem, "a folder with room for a report") from error
    return folder / REPORT_FILE


def _made(folder: Path, section: Section[Data], data: Data, formats: Sequence[str]) -> dict[str, Any] | None:
    """Return what the page needs of a section, with the figure as SVG, and write the figure's files."""
    figures, svg = folder / FIGURE_FOLDER, ""
    with figure_style(section.file or section.id):
        why_not = str(getattr(data, "why_not_drawn", "")) if section.of_movements else ""
        content = Content(caption=why_not) if why_not else section.content(data)
        if isinstance(content, Figure):
            content = Content(content, section.caption)
        if content is not None and content.figure is not None:
            figures.mkdir(exist_ok=True)
            for kind in formats:
                save_figure(content.figure, figures / f"{section.file}.{kind}")
            # The layout is settled; computing it again takes longer than drawing.
            content.figure.set_layout_engine("none")
            svg = inline_svg(content.figure, section.file)
    if section.file and figures.is_dir():
        for kind in set(FIGURE_FORMATS) - set(formats if svg else ()):  # of an earlier report
            (figures / f"{section.file}.{kind}").unlink(missing_ok=True)
    if content is None:
        return None
    first, *others = formats
    return {
        "id": section.id,
        "title": section.title,
        "svg": Markup(svg),
        "caption": content.caption,
        "files": ", ".join([f"{FIGURE_FOLDER}/{section.file}.{first}", *(f".{kind}" for kind in others)]),
        "html": content.html,
    }


def block(file: str, macro: str, *folder: Path, **values: Any) -> Markup:
    """Return the HTML of a macro in a template (of ours, or in ``folder``), called with these values."""
    module = template(file, *folder).make_module({"text": text, "fixed": fixed})
    html: Markup = getattr(module, macro)(**values)
    return html
