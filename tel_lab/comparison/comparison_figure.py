"""The figure of a comparison: a row a method, a panel a figure of merit, a dot an arm."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, NullFormatter, NullLocator

from tel_lab.comparison.comparison_table import GIVEN_MARK, GIVEN_NOTE, NEVER, NONE, heading, middle, values
from tel_lab.comparison.method_runs import Comparison
from tel_lab.comparison.results import COLUMNS, MeritColumn
from tel_ros.app.plotting import BLUE, FAINT, GREY, INK, ORANGE, SOFT

WIDTH_IN = 10.5
_ROW_IN = 0.27
_COLOURS = {"nothing": INK, "kinematics": INK, "urdf": ORANGE, "model": ORANGE}
_FAMILY = "tel_adaptive"
_CAPTION = (
    "Dots: medians over the arms; lines: their 95 % intervals; ticks below: single arms. Less is better."
)
_DOTS_BELOW = 0.25
"""How far below a method's median its arms are drawn, in rows."""


def comparison_figure(comparison: Comparison) -> Figure:
    specs = comparison.methods
    figure = Figure(figsize=(WIDTH_IN, 1.1 + _ROW_IN * len(specs)), layout="constrained")
    panels = figure.subplots(1, len(COLUMNS), sharey=True)
    for axes, column in zip(panels, COLUMNS, strict=True):
        _draw(axes, comparison, column)
    panels[0].set_yticks(range(len(specs)), [spec.title + GIVEN_MARK[spec.given] for spec in specs])
    panels[0].set_ylim(len(specs) - 0.4, -0.6)
    for label, spec in zip(panels[0].get_yticklabels(), specs, strict=True):
        label.set_color(_colour(spec.name, spec.given))
    figure.supxlabel(f"{_CAPTION}  {GIVEN_NOTE}", x=0.0, ha="left", fontsize=7.0, color=SOFT)
    return figure


def _colour(name: str, given: str) -> str:
    return BLUE if name.startswith(_FAMILY) else _COLOURS[given]


def _draw(axes: Axes, comparison: Comparison, column: MeritColumn) -> None:
    everything = [v for spec in comparison.methods for v in values(comparison, column, spec.name)]
    scale = 1e3 if column.in_mrad else 1.0
    known = [scale * value for value in everything if math.isfinite(value)]
    limits = _limits(known, column)
    never = any(map(math.isinf, everything))
    edge = _set_up(axes, limits, column, never)

    def place(value: float) -> float:
        return edge if math.isinf(value) else scale * value

    for row, spec in enumerate(comparison.methods):
        colour = _colour(spec.name, spec.given)
        found = middle(comparison, column, spec.name)
        if found is None:
            where = axes.get_yaxis_transform()
            axes.text(0.5, row, NONE, transform=where, ha="center", va="center", color=SOFT)
            continue
        arms = [place(value) for value in values(comparison, column, spec.name)]
        axes.plot(arms, np.full(len(arms), row + _DOTS_BELOW), "|", color=GREY, markersize=3.5, clip_on=False)
        if not math.isnan(found.low):
            axes.plot([place(found.low), place(found.high)], [row, row], color=colour, linewidth=1.6)
        axes.plot(place(found.value), row, "o", color=colour, markersize=4.0, clip_on=False)


def _limits(known: list[float], column: MeritColumn) -> tuple[float, float]:
    if not known:
        return (0.0, 1.0)
    if column.in_mrad:
        return (0.7 * min(known), 1.4 * max(known))
    return (-0.05 * max(*known, 1.0), 1.05 * max(*known, 1.0))


def _set_up(axes: Axes, limits: tuple[float, float], column: MeritColumn, never: bool) -> float:
    """Prepare a panel and return where on its axis "never" is."""
    low, high = limits
    logarithmic = column.in_mrad and low > 0.0
    edge = high * (high / low) ** 0.12 if logarithmic else high + 0.12 * (high - low)
    if logarithmic:
        axes.set_xscale("log")
        axes.xaxis.set_major_locator(FixedLocator(_decades(low, high)))
        axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axes.xaxis.set_minor_locator(NullLocator())
        axes.xaxis.set_minor_formatter(NullFormatter())
    axes.set_xlim(low, edge if never else high)
    axes.set_title(heading(column).replace(" to ", " to\n").replace(" on ", " on\n").replace(" [", "\n["))
    axes.grid(axis="both", color=FAINT)
    axes.set_axisbelow(True)
    axes.tick_params(axis="y", length=0.0)
    if never:
        axes.axvline(edge, color=SOFT, linewidth=0.6, linestyle=(0, (2.0, 2.0)))
        below_ticks = {"xytext": (0.0, -14.0), "textcoords": "offset points"}
        look: dict[str, Any] = {"ha": "center", "va": "top", "color": SOFT, "size": 7.0, **below_ticks}
        word = "aborted" if column.in_mrad else NEVER
        axes.annotate(word, (edge, 0.0), xycoords=axes.get_xaxis_transform(), **look)
    return edge


def _decades(low: float, high: float) -> list[float]:
    """Return 1, 10, 100 … inside the limits; with 3, 30, 300 … if there would be fewer than three."""
    exponents = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    tens = [10.0**k for k in exponents if low <= 10.0**k <= high]
    threes = [3.0 * 10.0**k for k in exponents if low <= 3.0 * 10.0**k <= high]
    return tens if len(tens) >= 3 else sorted(tens + threes)
