"""The figures of a report. Each function takes data and returns a figure; none of them reads a file."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator, MultipleLocator

from tel_ros.app.figure_export import BLUE, FAINT, GREEN, GREY, INK, ORANGE, PAPER, PURPLE, SOFT
from tel_ros.app.hand_path import drawing_plane, hand_path
from tel_ros.app.report_data import DrawnTrial
from tel_ros.app.report_text import enumeration, seconds, significant, trial_label
from tel_ros.core.kinematics import SerialChain
from tel_ros.core.types import BoolArray, FloatArray

WIDTH_IN = 7.2
"""Across both columns of a paper."""

_PAGE_IN = 9.7
"""Height of what fits on a page with its caption."""
_LEGEND_IN = 0.27
_PATH_COLUMNS = 3
_TRIAL_COLOURS = (ORANGE, GREEN, BLUE)
_VISIBLE_SHARE = 0.3
"""An effort limit is drawn unless the efforts reach less than this share of it and would look flat."""
_BAND_ALPHA = 0.2
_BAND_POINTS = 400
_BAND_LABEL = "±2 standard deviations that the network expected of its command"


@dataclass(frozen=True)
class PathPanel:
    """One trial of the figure of the hand's path; arrays of shape (n, 2) in m."""

    title: str
    desired_m: FloatArray
    actual_m: FloatArray
    equilibrium_m: FloatArray
    completed: bool


def path_panels(drawn: Sequence[DrawnTrial], chain: SerialChain) -> tuple[list[PathPanel], str, list[str]]:
    """Return the data of the figure of the hand's path.

    Args:
        drawn: the trials; at least one.
        chain: from the base to the hand.

    Returns:
        One panel a trial, all in one plane; a sentence about the plane; labels of its two axes.
    """
    paths = [hand_path(trial.recorded, chain) for trial in drawn]
    plane = drawing_plane(np.vstack([path.all_m for path in paths]))
    panels = [
        PathPanel(
            title=f"{trial_label(trial.summary)}\n{seconds(trial.summary.duration_s)}, "
            f"RMS error {significant(trial.summary.rms_error_rad)} rad",
            desired_m=plane.project(path.desired_m),
            actual_m=plane.project(path.actual_m),
            equilibrium_m=plane.project(path.equilibrium_m),
            completed=trial.summary.completed,
        )
        for trial, path in zip(drawn, paths, strict=True)
    ]
    return panels, plane.description, [f"{name} [m]" for name in plane.names]


def hand_path_figure(panels: Sequence[PathPanel], labels: Sequence[str]) -> Figure:
    """Return [Practice] Fig. 2: desired, actual and equilibrium path of the hand, three in a row."""
    columns = min(_PATH_COLUMNS, len(panels))
    rows = math.ceil(len(panels) / columns)
    frame = _frame(panels)
    panel_in = min((WIDTH_IN - 0.75) / columns, 4.0 / frame.aspect, 3.6)
    figure = Figure(figsize=(WIDTH_IN, rows * (panel_in * frame.aspect + 0.6) + 0.55), layout="compressed")
    grid = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    for axes in grid.flat[len(panels) :]:
        axes.remove()
    for place, (axes, panel) in enumerate(zip(grid.flat, panels, strict=False)):
        _draw_path(axes, panel, frame)
        if place + columns >= len(panels):
            axes.set_xlabel(labels[0])
            axes.tick_params(labelbottom=True)
        if place % columns == 0:
            axes.set_ylabel(labels[1])
    legend_below(figure, "compressed", [_path_handles(panels)])
    return figure


def path_pictures(panels: Sequence[PathPanel], labels: Sequence[str]) -> Iterator[Figure]:
    """Yield the figure of the hand's path once for each trial, always in the same frame.

    It is one figure that is drawn into anew: what is wanted of it has to be taken before the next one.
    """
    frame = _frame(panels)
    size_in = min(WIDTH_IN - 0.75, 4.0 / frame.aspect)
    figure = Figure(figsize=(WIDTH_IN, size_in * frame.aspect + 1.15), layout="compressed")
    axes = figure.subplots()
    legend_below(figure, "compressed", [_path_handles(panels)])
    for place, panel in enumerate(panels):
        axes.clear()
        _draw_path(axes, panel, frame)
        axes.set(xlabel=labels[0], ylabel=labels[1])
        if place == 0:
            figure.draw_without_rendering()
            figure.set_layout_engine("none")  # so that nothing jumps from one to the next
        yield figure


def _path_handles(panels: Sequence[PathPanel]) -> list[Line2D]:
    handles = [
        Line2D([], [], color=INK, linestyle=DOTS, linewidth=1.0, label="desired"),
        Line2D([], [], color=BLUE, linewidth=1.0, label="actual"),
        Line2D([], [], color=GREY, linewidth=1.4, label="equilibrium point (EP)"),
        Line2D([], [], **_START, label="start"),
    ]
    if not all(panel.completed for panel in panels):
        handles.append(Line2D([], [], **BROKEN_OFF, label="broken off"))
    return handles


def legend_below(
    figure: Figure, layout: Literal["constrained", "compressed"], rows: Sequence[Sequence[Artist]]
) -> None:
    """Put a legend under the axes, row by row.

    The layout is told to leave room for it: places outside the axes are known from matplotlib 3.7 on, and
    ROS 2 Jazzy comes with 3.6.
    """
    row = _LEGEND_IN / figure.get_figheight()
    figure.set_layout_engine(layout, rect=(0.0, len(rows) * row, 1.0, 1.0 - len(rows) * row))
    for place, handles in enumerate(reversed(rows)):
        figure.legend(
            handles=handles,
            loc="lower center",
            bbox_to_anchor=(0.5, place * row),
            ncols=len(handles),
            columnspacing=1.6,
        )


DOTS = (0, (1.0, 2.0))
"""Of what is desired."""
_START: dict[str, Any] = {
    "marker": "o",
    "markersize": 5.0,
    "markerfacecolor": PAPER,
    "markeredgecolor": INK,
    "markeredgewidth": 1.0,
    "linestyle": "none",
}
BROKEN_OFF: dict[str, Any] = {
    "marker": "x",
    "markersize": 5.5,
    "markeredgecolor": PURPLE,
    "markeredgewidth": 1.4,
    "linestyle": "none",
}
"""Where a trial ended before its time."""


@dataclass(frozen=True)
class _Frame:
    """What all panels show of the plane."""

    low_m: FloatArray
    high_m: FloatArray

    @property
    def aspect(self) -> float:
        """Height over width."""
        width, height = self.high_m - self.low_m
        return float(height / width)


def _frame(panels: Sequence[PathPanel]) -> _Frame:
    everything = np.vstack([np.vstack([p.desired_m, p.actual_m, p.equilibrium_m]) for p in panels])
    low, high = everything.min(axis=0), everything.max(axis=0)
    margin_m = 0.06 * max(float((high - low).max()), 1e-3)
    return _Frame(low - margin_m, high + margin_m)


def _tick_distance(extent_m: FloatArray) -> float:
    """Return one distance between ticks for both axes: squares look like squares."""
    tick_m = float(np.diff(MaxNLocator(5, steps=[1, 2, 5, 10]).tick_values(0.0, extent_m.max()))[0])
    half_is_better = extent_m.min() < 2.0 * tick_m and extent_m.max() < 3.5 * tick_m
    return tick_m / 2.0 if half_is_better else tick_m


def _draw_path(axes: Axes, panel: PathPanel, frame: _Frame) -> None:
    axes.plot(*panel.equilibrium_m.T, color=GREY, linewidth=1.4)
    axes.plot(*panel.actual_m.T, color=BLUE, linewidth=1.0)
    axes.plot(*panel.desired_m.T, color=INK, linestyle=DOTS, linewidth=1.0, dash_capstyle="butt")
    axes.plot(*panel.actual_m[0], **_START)
    if not panel.completed:
        axes.plot(*panel.actual_m[-1], **BROKEN_OFF)
    axes.set_title(panel.title, linespacing=1.4)
    low, high = frame.low_m, frame.high_m
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
    tick_m = _tick_distance(high - low)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MultipleLocator(tick_m))


def effort_figure(drawn: Sequence[DrawnTrial], joints: Sequence[str], limits_nm: Sequence[float]) -> Figure:
    """Return the commanded effort of each joint over the time of a movement, with limits and clipping.

    Args:
        drawn: the trials.
        joints: names.
        limits_nm: effort limits, one for each joint.
    """
    figure, panels = movement_panels(joints)
    clipped = limited = False
    for joint, axes in enumerate(panels):
        for trial, colour in zip(drawn, _colours(drawn), strict=True):
            time, effort_nm = movement_time(trial), trial.recorded.effort_nm[trial.recorded.run, joint]
            axes.plot(time, effort_nm, color=colour, linewidth=0.9)
            saturated = trial.recorded.saturated[trial.recorded.run, joint]
            clipped |= mark_saturated(axes, time, effort_nm, saturated)
        limited |= draw_limit(axes, limits_nm[joint])
        axes.set_ylabel("torque [N·m]")
    handles = _trial_handles(drawn)
    if limited:
        handles.append(Line2D([], [], color=SOFT, linestyle="--", linewidth=0.9, label="limit"))
    if clipped:
        handles.append(Line2D([], [], color=PURPLE, linewidth=4.0, alpha=0.55, label="clipped at the limit"))
    legend_below(figure, "constrained", [handles])
    return figure


def tracking_figure(drawn: Sequence[DrawnTrial], joints: Sequence[str]) -> Figure:
    """Return measured minus desired position of each joint over the time of a movement.

    A trial whose error the network expected has panels of its own, with the band: beside the error of a
    trial before learning, or the wider band of a faster one, there would be nothing to see of it.
    """
    coloured = list(zip(drawn, _colours(drawn), strict=True))
    banded = [(trial, colour) for trial, colour in coloured if trial.is_std_known]
    columns = [(trial_label(trial.summary).lower(), [(trial, colour)], True) for trial, colour in banded]
    if len(banded) < len(drawn):
        numbers = enumeration([str(trial.summary.index) for trial in drawn])
        columns.insert(0, (f"trials {numbers}", coloured, False))
    titles = [f"{joint}: {head}" if banded else joint for joint in joints for head, *_ in columns]
    figure, panels = movement_panels(titles, max(2, len(columns)))
    for place, axes in enumerate(panels):
        joint, column = divmod(place, len(columns))
        _, shown, with_band = columns[column]
        for trial, colour in shown:
            if with_band:
                _draw_band(axes, trial, colour, joint)
            _draw_error(axes, trial, colour, joint)
        if column == 0:
            axes.set_ylabel("actual − desired [rad]")
    handles: list[Artist] = list(_trial_handles(drawn))
    if not all(trial.summary.completed for trial in drawn):
        handles.append(Line2D([], [], **BROKEN_OFF, label="broken off"))
    rows = [handles]
    if banded:
        rows.append([Patch(facecolor=SOFT, alpha=0.3, linewidth=0.0, label=_BAND_LABEL)])
    legend_below(figure, "constrained", rows)
    return figure


def _draw_error(axes: Axes, trial: DrawnTrial, colour: str, joint: int) -> None:
    time, error_rad = movement_time(trial), trial.error_rad[:, joint]
    axes.plot(time, error_rad, color=colour, linewidth=1.1)
    if not trial.summary.completed:
        axes.plot(time[-1], error_rad[-1], **BROKEN_OFF)


def _draw_band(axes: Axes, trial: DrawnTrial, colour: str, joint: int) -> None:
    """Draw what the network expected of its command, where it expected anything finite."""
    half_rad = 2.0 * trial.recorded.command_std_rad[:, joint]
    # Unlike a line, an area is written with all of its points, and thousands would show no more.
    rows = np.unique(np.linspace(0, len(half_rad) - 1, _BAND_POINTS).round().astype(int))
    time, half_rad = movement_time(trial)[rows], half_rad[rows]
    known = np.isfinite(half_rad)
    half_rad = np.where(known, half_rad, 0.0)
    style: dict[str, Any] = {"color": colour, "alpha": _BAND_ALPHA, "linewidth": 0.0, "zorder": 0.8}
    axes.fill_between(time, -half_rad, half_rad, where=known, **style)


def movement_panels(titles: Sequence[str], columns: int = 2) -> tuple[Figure, list[Axes]]:
    """Return a figure with one panel a title over the time of a movement, and the panels row by row."""
    columns = min(columns, len(titles))
    rows = math.ceil(len(titles) / columns)
    figure = Figure(figsize=(WIDTH_IN, min(2.2 * rows + 0.5, _PAGE_IN)), layout="constrained")
    grid = figure.subplots(rows, columns, sharex=True, squeeze=False)
    panels = list(grid.flat)
    for axes in panels[len(titles) :]:
        axes.remove()
    panels = panels[: len(titles)]
    for place, (axes, title) in enumerate(zip(panels, titles, strict=True)):
        axes.axhline(0.0, color=FAINT, linewidth=0.7, zorder=0.5)
        axes.set_title(title)
        axes.set_xlim(-0.01, 1.01)
        axes.xaxis.set_major_locator(MultipleLocator(0.2 if columns < 3 else 0.5))
        if place + columns >= len(titles):
            axes.set_xlabel("time / duration of the trial")
            axes.tick_params(labelbottom=True)
    return figure, panels


def movement_time(trial: DrawnTrial) -> FloatArray:
    """Return the time of each sample of RUN as a share of the trial's duration."""
    time: FloatArray = trial.recorded.time_s[trial.recorded.run] / trial.summary.duration_s
    return time


def _colours(drawn: Sequence[DrawnTrial]) -> tuple[str, ...]:
    return _TRIAL_COLOURS[-len(drawn) :] if len(drawn) != 2 else (_TRIAL_COLOURS[0], _TRIAL_COLOURS[-1])


def _trial_handles(drawn: Sequence[DrawnTrial]) -> list[Line2D]:
    return [
        Line2D(
            [],
            [],
            color=colour,
            label=f"{trial_label(trial.summary)} ({seconds(trial.summary.duration_s)})",
        )
        for trial, colour in zip(drawn, _colours(drawn), strict=True)
    ]


def mark_saturated(axes: Axes, time: FloatArray, effort_nm: FloatArray, saturated: BoolArray) -> bool:
    """Lay a broad band over the samples that were clipped; return whether there were any."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], saturated, [False]]).astype(int)))
    if not len(edges):
        return False
    half = (time[-1] - time[0]) / max(1, len(time) - 1) / 2.0
    bands = []
    for first, end in edges.reshape(-1, 2):
        # Half a sample more at both ends: a single sample has a length, too.
        ends = np.concatenate([[time[first] - half], time[first:end], [time[end - 1] + half]])
        bands.append(np.column_stack([ends, np.pad(effort_nm[first:end], 1, mode="edge")]))
    axes.add_collection(LineCollection(bands, colors=PURPLE, linewidths=4.0, alpha=0.55, capstyle="butt"))
    return True


def draw_limit(axes: Axes, limit_nm: float) -> bool:
    """Draw the effort limit, or only name it if the curves would be flat beside it; return which."""
    low, high = axes.get_ylim()
    if max(-low, high) < _VISIBLE_SHARE * limit_nm:
        axes.set_title(f"limit ±{limit_nm:g} N·m, off the scale", loc="right", color=SOFT, fontsize=7.5)
        return False
    for side in (-limit_nm, limit_nm):
        axes.axhline(side, color=SOFT, linestyle="--", linewidth=0.9)
    axes.set_ylim(-1.12 * limit_nm, 1.12 * limit_nm)
    return True
