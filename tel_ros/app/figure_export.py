"""Figures as files for papers, and as SVG that takes its colours and font from the page around it."""

from __future__ import annotations

import io
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.figure import Figure

PALETTE = {
    "ink": ("#1b1f24", "#e9e7e3"),
    "soft": ("#59626e", "#a5adb8"),
    "faint": ("#d5d9df", "#3b424c"),
    "paper": ("#ffffff", "#15181d"),
    "grey": ("#a2a9b3", "#7f8894"),
    "blue": ("#0072b2", "#5ab4ee"),
    "orange": ("#d55e00", "#ff9a55"),
    "green": ("#009e73", "#3ccfa5"),
    "purple": ("#a3327a", "#f08cc8"),
}
"""Colour-blind safe (after Okabe and Ito): name to the colours on a light and on a dark page."""

INK, SOFT, FAINT, PAPER, GREY, BLUE, ORANGE, GREEN, PURPLE = (light for light, _ in PALETTE.values())

_PNG_DPI = 200
_UNDATED: dict[str, dict[str, None]] = {
    "png": {"Software": None},
    "svg": dict.fromkeys(("Creator", "Date", "Format", "Type")),
    "pdf": dict.fromkeys(("Creator", "Producer", "CreationDate")),
}
"""Equal data give equal files."""

_STYLE: dict[str, Any] = {
    "font.family": "DejaVu Sans",  # comes with matplotlib: the same figure on every machine
    "font.size": 8.0,
    "axes.titlesize": 8.0,
    "axes.titlelocation": "left",
    "axes.labelsize": 8.0,
    "axes.labelcolor": INK,
    "axes.edgecolor": SOFT,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.unicode_minus": True,
    "axes.grid": False,
    "grid.color": FAINT,
    "grid.linewidth": 0.5,
    "legend.frameon": False,
    "legend.fontsize": 8.0,
    "legend.handlelength": 2.2,
    "lines.linewidth": 1.2,
    "lines.solid_capstyle": "round",
    "lines.solid_joinstyle": "round",
    "text.color": INK,
    "text.parse_math": False,  # names of joints are names, even with a dollar sign in them
    "xtick.color": SOFT,
    "ytick.color": SOFT,
    "xtick.labelcolor": SOFT,
    "ytick.labelcolor": SOFT,
    "xtick.labelsize": 7.5,
    "ytick.labelsize": 7.5,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "xtick.major.size": 3.0,
    "ytick.major.size": 3.0,
    "xtick.minor.size": 1.5,
    "ytick.minor.size": 1.5,
    "svg.fonttype": "none",
    "pdf.fonttype": 42,  # letters that can be searched, and that journals take
}


@contextmanager
def figure_style(name: str) -> Iterator[None]:
    """Draw and save figures in one style; equal data give equal files.

    Args:
        name: of the figure.
    """
    # matplotlib's own defaults first, so that nobody's matplotlibrc shows in a report.
    style: dict[Any, Any] = {**matplotlib.rcParamsDefault, **_STYLE, "svg.hashsalt": name}
    with matplotlib.rc_context(style):
        yield


def save_figure(figure: Figure, path: Path) -> None:
    """Write a figure so that a reader finds the old file or the new one, never half of one.

    Args:
        figure: drawn in :func:`figure_style`.
        path: of the file; its ending, .png, .svg or .pdf, says which format.
    """
    kind = path.suffix[1:]
    beside = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    # Letters as paths: wherever the SVG is shown, it looks like the PNG.
    with matplotlib.rc_context({"svg.fonttype": "path"}):
        figure.savefig(beside, format=kind, dpi=_PNG_DPI, facecolor=PAPER, metadata=_UNDATED[kind])
    beside.replace(path)


def inline_svg(figure: Figure, name: str) -> str:
    """Return a figure as an ``<svg>`` element to put into a page.

    Colours become variables of the page's style, so that they follow light and dark; identifiers get the
    name in front, so that the figures of a page do not take each other's parts.
    """
    buffer = io.StringIO()
    figure.savefig(buffer, format="svg", transparent=True, metadata=_UNDATED["svg"])
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    # A style sheet inside one figure would hold for the whole page; the page brings its own.
    text = re.sub(r"<style\b.*?</style>", "", text, flags=re.DOTALL)
    text = re.sub(r"<svg\b[^>]*>", lambda match: _root(match.group()), text, count=1)
    text = text.replace("xlink:href=", "href=")
    text = re.sub(r'(\bid="|\bhref="#|url\(#)', rf"\g<1>{name}-", text)
    for colour, (light, _) in PALETTE.items():
        text = text.replace(light, f"var(--{colour})")
    return text


def _root(tag: str) -> str:
    view = re.search(r'viewBox="[^"]*"', tag)
    return f'<svg {view.group() if view else ""} aria-hidden="true">'
