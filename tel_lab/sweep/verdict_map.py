"""The map of a sweep: which way of practising works where, and what becomes of it elsewhere."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from enum import Enum
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle

from tel_lab.sweep.plan import MapPlan
from tel_lab.sweep.point import FAILED, MEASURES
from tel_ros.app.plotting import INK, PAPER, SOFT, WIDTH_IN

Row = Mapping[str, Any]

_COLUMNS = 3
_CELL_IN = 0.36
_LEGEND_LINE_IN = 0.155


class Verdict(Enum):
    """What became of a practice run; the value is what the legend says, with {} for the tolerance."""

    REACHED = "goal within {}"
    ABOVE = "goal speed reached, error above {}"
    STOPPED = "practice stopped itself below the goal speed"
    LOCKED_UP = "learning lock-up"
    UNSTABLE = "unstable: broken off, last trial aborted, or error grown beyond the first"
    FAILED = "no result"


_COLOURS = {
    # After Okabe and Ito; distinguishable by lightness as well, where it is good from where it is bad.
    Verdict.REACHED: "#0072b2",
    Verdict.ABOVE: "#a9d3ee",
    Verdict.STOPPED: "#d5d9df",
    Verdict.LOCKED_UP: "#f0c943",
    Verdict.UNSTABLE: "#d55e00",
    Verdict.FAILED: PAPER,
}
_WHITE_TEXT = (Verdict.REACHED, Verdict.UNSTABLE)


def verdict(row: Row, tolerance_rad: float) -> Verdict:
    """Return what became of a row of the table; a last RMS error within the tolerance is good."""
    warning, final_rad = row["warning"] or "", row["rms_final_rad"]
    if row["outcome"] == FAILED and row["trials"] is None:
        return Verdict.FAILED
    if row["outcome"] == FAILED or final_rad is None:
        return Verdict.UNSTABLE
    if not row["goal_reached"]:
        return Verdict.STOPPED
    if final_rad <= tolerance_rad:
        return Verdict.REACHED
    if "diverges" in warning and final_rad > (row["rms_first_rad"] or 0.0):
        return Verdict.UNSTABLE
    return Verdict.LOCKED_UP if "lock-up" in warning else Verdict.ABOVE


def map_figure(rows: Sequence[Row], plan: MapPlan) -> Figure:
    """Return a panel for each case (and value of every other key), a cell for each pair of x and y.

    A cell has a stripe for each seed. Its numbers are the largest over the seeds.
    """
    panels: dict[str, list[Row]] = {}
    for row in rows:
        panels.setdefault(_panel_of(row, plan), []).append(row)
    xs, ys = (list(dict.fromkeys(row[key] for row in rows)) for key in (plan.x, plan.y))
    columns = min(_COLUMNS, len(panels))
    lines = math.ceil(len(panels) / columns)
    verdicts = [v for v in Verdict if any(verdict(row, plan.tolerance_rad) is v for row in rows)]
    legend_in = _LEGEND_LINE_IN * math.ceil((len(verdicts) + 2) / 2) + 0.12
    height_in = lines * (len(ys) * _CELL_IN + 0.4) + 0.4 + legend_in
    figure = Figure(figsize=(WIDTH_IN, height_in))
    legend = legend_in / height_in
    figure.set_layout_engine("constrained", rect=(0.0, legend, 1.0, 1.0 - legend))
    all_axes = figure.subplots(lines, columns, squeeze=False, sharex=True, sharey=True).ravel()
    for axes in all_axes[len(panels) :]:
        axes.set_axis_off()
    for axes, (title, members) in zip(all_axes, panels.items(), strict=False):
        axes.set_title(title)
        axes.set(xlim=(0.0, len(xs)), ylim=(0.0, len(ys)))
        for set_ticks, values in ((axes.set_xticks, xs), (axes.set_yticks, ys)):
            names = [f"{value}" if isinstance(value, str) else f"{value:g}" for value in values]
            set_ticks([i + 0.5 for i in range(len(values))], names)
        axes.tick_params(length=0.0)
        axes.spines[:].set_visible(False)
        for i, x in enumerate(xs):
            for j, y in enumerate(ys):
                cell = [row for row in members if row[plan.x] == x and row[plan.y] == y]
                _draw_cell(axes, i, j, cell, plan.tolerance_rad)
        _draw_limit(axes, members, plan, xs, ys)
    for number, axes in enumerate(all_axes[: len(panels)]):
        if number + columns >= len(panels):
            axes.tick_params(labelbottom=True)
            axes.set_xlabel(plan.x_label or plan.x)
        if number % columns == 0:
            axes.set_ylabel(plan.y_label or plan.y)
    _draw_legend(figure, verdicts, plan.tolerance_rad)
    return figure


def _panel_of(row: Row, plan: MapPlan) -> str:
    apart = {"seed", "config_hash", plan.x, plan.y, *MEASURES}
    others = {key: value for key, value in row.items() if key not in apart}
    return ", ".join(str(value) if key == "case" else f"{key} = {value}" for key, value in others.items())


def _draw_cell(axes: Axes, i: int, j: int, cell: Sequence[Row], tolerance_rad: float) -> None:
    """Draw one stripe a seed and two numbers: the final RMS error in mrad, the largest deviation in rad."""
    if not cell:
        return
    found = [verdict(row, tolerance_rad) for row in cell]
    width = 1.0 / len(cell)
    for k, what in enumerate(found):
        where = (i + k / len(cell), j)
        axes.add_patch(Rectangle(where, width, 1.0, facecolor=_COLOURS[what], edgecolor="none"))
    axes.add_patch(Rectangle((i, j), 1.0, 1.0, facecolor="none", edgecolor=PAPER, linewidth=1.2))
    colour = PAPER if all(what in _WHITE_TEXT for what in found) else INK
    finals, largest = ([row[key] for row in cell] for key in ("rms_final_rad", "max_error_rad"))
    centre: dict[str, Any] = {"ha": "center", "va": "center", "color": colour}
    final = "–" if None in finals else f"{1e3 * max(finals):.{0 if 1e3 * max(finals) >= 1.0 else 1}f}"
    axes.text(i + 0.5, j + 0.64, final, fontsize=7.0, **centre)
    if any(value is not None for value in largest):
        text = f"{max(value for value in largest if value is not None):.2f}"
        axes.text(i + 0.5, j + 0.27, text, fontsize=5.2, **centre)


def _draw_limit(axes: Axes, rows: Sequence[Row], plan: MapPlan, xs: Sequence[Any], ys: Sequence[Any]) -> None:
    """Draw a line around the cells whose goal movement needs more effort than there is."""
    beyond = {
        (xs.index(row[plan.x]), ys.index(row[plan.y]))
        for row in rows
        if row["goal_effort_ratio"] is not None and row["goal_effort_ratio"] > 1.0
    }
    for i, j in beyond:
        sides = {
            (i - 1, j): ((i, i), (j, j + 1)),
            (i + 1, j): ((i + 1, i + 1), (j, j + 1)),
            (i, j - 1): ((i, i + 1), (j, j)),
            (i, j + 1): ((i, i + 1), (j + 1, j + 1)),
        }
        for other, (x, y) in sides.items():
            if other not in beyond:
                axes.plot(x, y, color=INK, linewidth=1.4, solid_capstyle="projecting", clip_on=False)


def _draw_legend(figure: Figure, verdicts: Sequence[Verdict], tolerance_rad: float) -> None:
    tolerance = f"{1e3 * tolerance_rad:g} mrad RMS"
    handles: list[Any] = [
        Patch(facecolor=_COLOURS[v], edgecolor=SOFT, linewidth=0.4, label=v.value.format(tolerance))
        for v in verdicts
    ]
    line = Line2D([], [], color=INK, linewidth=1.4, label="inside: the goal needs more than the effort limit")
    meaning = "large: RMS error of the last trial [mrad]; small: largest deviation [rad]"
    handles += [line, Line2D([], [], linestyle="none", label=meaning)]
    look = {"fontsize": 7.0, "columnspacing": 1.5, "handlelength": 1.4}
    figure.legend(handles=handles, loc="lower center", ncols=2, **look)
