"""One style for all figures, the parts that they share, and how they become files or SVG in a page."""

from __future__ import annotations

import io
import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from tel_ros.core.trial import Outcome, TrialReport
from tel_ros.core.types import BoolArray, FloatArray, IntArray
from tel_ros.recording.shared_files import replacing

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

WIDTH_IN = 7.2
"""Across both columns of a paper."""
DOTS = (0, (1.0, 2.0))
"""Line style of what is desired."""
BROKEN_OFF: dict[str, Any] = {
    "marker": "x",
    "markersize": 5.5,
    "markeredgecolor": PURPLE,
    "markeredgewidth": 1.4,
    "linestyle": "none",
}
"""Where a trial ended before its time."""
CLIPPED: dict[str, Any] = {"color": PURPLE, "linewidth": 4.0, "alpha": 0.55}
LIMIT: dict[str, Any] = {"color": SOFT, "linestyle": "--", "linewidth": 0.9}

_VISIBLE_SHARE = 0.3
"""An effort limit is not drawn if the efforts reach less than this share of it: they would look flat."""
_UNDATED: dict[str, dict[str, None]] = {
    "png": {"Software": None},
    "svg": dict.fromkeys(("Creator", "Date", "Format", "Type")),
    "pdf": dict.fromkeys(("Creator", "Producer", "CreationDate")),
}
"""No dates and versions in the files: equal data give equal files."""

_TICKS = {"color": SOFT, "labelsize": 7.5, "major.width": 0.6, "major.size": 3.0, "minor.size": 1.5}
_STYLE: dict[str, Any] = {
    "font.family": "DejaVu Sans",  # comes with matplotlib: the same figure on every machine
    "font.size": 8.0,
    "axes.titlesize": 8.0,
    "axes.titlelocation": "left",
    "axes.labelcolor": INK,
    "axes.edgecolor": SOFT,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "grid.color": FAINT,
    "grid.linewidth": 0.5,
    "legend.frameon": False,
    "legend.handlelength": 2.2,
    "lines.linewidth": 1.2,
    "lines.solid_capstyle": "round",
    "text.color": INK,
    "text.parse_math": False,  # names of joints are names, even with a dollar sign in them
    **{f"{axis}tick.{key}": value for axis in "xy" for key, value in _TICKS.items()},
    "svg.fonttype": "none",
    "pdf.fonttype": 42,  # letters that can be searched, and that journals take
}


@contextmanager
def figure_style(name: str) -> Iterator[None]:
    """Draw and save the figure of this name in the common style; equal data give equal files."""
    # matplotlib's own defaults first, so that nobody's matplotlibrc shows in a report.
    style: dict[Any, Any] = {**matplotlib.rcParamsDefault, **_STYLE, "svg.hashsalt": name}
    with matplotlib.rc_context(style):
        yield


def save_figure(figure: Figure, path: Path) -> None:
    """Write a figure in one step, so that nobody reads half a file; the ending is .png, .svg or .pdf."""
    kind = path.suffix[1:]
    # Letters as paths: the SVG looks like the PNG wherever it is shown.
    with matplotlib.rc_context({"svg.fonttype": "path"}), replacing(path) as file:
        figure.savefig(file, format=kind, dpi=200, facecolor=PAPER, metadata=_UNDATED[kind])


def inline_svg(figure: Figure, name: str) -> str:
    """Return a figure as an ``<svg>`` element for a page.

    Colours become variables of the page's style, which follow light and dark; ids get the name in front.
    """
    buffer = io.StringIO()
    figure.savefig(buffer, format="svg", transparent=True, metadata=_UNDATED["svg"])
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    # A style sheet inside one figure would hold for the whole page; the page brings its own.
    text = re.sub(r"<style\b.*?</style>", "", text, flags=re.DOTALL)
    text = re.sub(r'<svg\b[^>]*(viewBox="[^"]*")[^>]*>', r'<svg \1 aria-hidden="true">', text, count=1)
    text = text.replace("xlink:href=", "href=")
    text = re.sub(r'(\bid="|\bhref="#|url\(#)', rf"\g<1>{name}-", text)
    for colour, (light, _) in PALETTE.items():
        text = text.replace(light, f"var(--{colour})")
    return text


def legend_below(figure: Figure, *rows: Sequence[Artist]) -> None:
    """Put a legend under the axes, row by row.

    The room is left by hand: matplotlib does it from 3.7 on only, and ROS 2 Jazzy comes with 3.6.
    """
    rows = tuple(row for row in rows if row)
    height = 0.27 / figure.get_figheight()  # 0.27 in
    engine: Any = figure.get_layout_engine()
    engine.set(rect=(0.0, len(rows) * height, 1.0, 1.0 - len(rows) * height))
    for place, handles in enumerate(reversed(rows)):
        figure.legend(
            handles=handles,
            loc="lower center",
            bbox_to_anchor=(0.5, place * height),
            ncols=len(handles),
            columnspacing=1.6,
        )


def key(label: str, **style: Any) -> Line2D:
    """Return an entry of a legend."""
    return Line2D([], [], label=label, **style)


def broken_off(trials: Iterable[TrialReport]) -> list[Line2D]:
    """Return the entry for where trials ended before their time; none if all were completed."""
    completed = all(trial.outcome == Outcome.COMPLETED for trial in trials)
    return [] if completed else [key("broken off", **BROKEN_OFF)]


def scale_errors(axes: Axes) -> None:
    """Give the vertical axis decades, with numbers that need no exponent."""
    axes.set_yscale("log")
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0), numticks=12))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:.10g}"))
    axes.yaxis.set_minor_formatter(NullFormatter())


def stretches(where: BoolArray) -> IntArray:
    """Return begin and end (exclusive) of each unbroken stretch of true values. Shape (n_stretches, 2)."""
    edges: IntArray = np.flatnonzero(np.diff(np.concatenate([[False], where, [False]]).astype(int)))
    return edges.reshape(-1, 2)


def mark_saturated(axes: Axes, time: FloatArray, effort_nm: FloatArray, saturated: BoolArray) -> bool:
    """Lay a broad band over the samples that were clipped; return whether there were any."""
    half = (time[-1] - time[0]) / max(1, len(time) - 1) / 2.0
    bands = []
    for first, end in stretches(saturated):
        # Half a sample more at both ends, so that a single sample has a length.
        ends = np.concatenate([[time[first] - half], time[first:end], [time[end - 1] + half]])
        bands.append(np.column_stack([ends, np.pad(effort_nm[first:end], 1, mode="edge")]))
    if bands:
        axes.add_collection(LineCollection(bands, **CLIPPED, capstyle="butt"))
    return bool(bands)


def draw_limit(axes: Axes, limit_nm: float) -> bool:
    """Draw the effort limit, or only name it if the curves would be flat beside it; return whether drawn."""
    low, high = axes.get_ylim()
    if max(-low, high) < _VISIBLE_SHARE * limit_nm:
        axes.set_title(f"limit ±{limit_nm:g} N·m, off the scale", loc="right", color=SOFT, fontsize=7.5)
        return False
    for side in (-limit_nm, limit_nm):
        axes.axhline(side, **LIMIT)
    axes.set_ylim(-1.12 * limit_nm, 1.12 * limit_nm)
    return True
