"""The figures of a report: each function takes data and returns a figure; none of them reads a file."""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator, MultipleLocator

from tel_ros.app import plotting as plot
from tel_ros.app.plane import drawing_plane
from tel_ros.app.report.data import DrawnTrial, RunData, TrialRow
from tel_ros.app.report.text import enumeration, seconds, significant, trial_label
from tel_ros.core.kinematics import SerialChain
from tel_ros.core.types import FloatArray, evenly_spaced

_START: dict[str, Any] = {
    "marker": "o",
    "markersize": 5.0,
    "markerfacecolor": plot.PAPER,
    "markeredgecolor": plot.INK,
    "markeredgewidth": 1.0,
    "linestyle": "none",
}


@dataclass(frozen=True)
class PathPanel:
    """The path of the hand in RUN of one trial, in the plane it is drawn in; arrays of shape (n, 2) in m."""

    title: str
    trial: TrialRow
    desired_m: FloatArray
    actual_m: FloatArray
    equilibrium_m: FloatArray
    """Where the hand would come to rest under the command."""


def path_panels(
    drawn: Sequence[DrawnTrial], chain: SerialChain, most_points: int = sys.maxsize
) -> tuple[list[PathPanel], str, list[str]]:
    """Return a panel of the hand's path for each trial, a sentence about their plane, labels of its axes."""
    paths = []
    for trial in (each.recorded for each in drawn):
        angles = (trial.desired[:, : len(trial.joints)], trial.position_rad, trial.equilibrium_rad)
        paths.append([chain.hand_positions(each[trial.run]) for each in angles])
    plane = drawing_plane(np.vstack([curve for path in paths for curve in path]))

    def shown(curve_m: FloatArray) -> FloatArray:
        return plane.project(curve_m)[evenly_spaced(len(curve_m), most_points)]

    panels = [
        PathPanel(
            f"{trial_label(row)}\n{seconds(row.duration_s)}, RMS error {significant(row.rms_error_rad)} rad",
            row,
            *map(shown, path),
        )
        for row, path in zip((each.summary for each in drawn), paths, strict=True)
    ]
    return panels, plane.description, [f"{name} [m]" for name in plane.names]


def hand_path_figure(panels: Sequence[PathPanel], labels: Sequence[str]) -> Figure:
    """Return [Practice] Fig. 2: desired, actual and equilibrium path of the hand, three in a row."""
    columns = min(3, len(panels))
    rows = math.ceil(len(panels) / columns)
    *corners_m, aspect = _frame(panels)
    panel_in = min((plot.WIDTH_IN - 0.75) / columns, 4.0 / aspect, 3.6)
    figure = Figure(figsize=(plot.WIDTH_IN, rows * (panel_in * aspect + 0.6) + 0.55), layout="compressed")
    grid = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    for axes in grid.flat[len(panels) :]:
        axes.remove()
    for place, (axes, panel) in enumerate(zip(grid.flat, panels, strict=False)):
        _draw_path(axes, panel, *corners_m)
        if place + columns >= len(panels):
            axes.set_xlabel(labels[0])
            axes.tick_params(labelbottom=True)
        if place % columns == 0:
            axes.set_ylabel(labels[1])
    plot.legend_below(figure, _path_handles(panels))
    return figure


def path_pictures(panels: Sequence[PathPanel], labels: Sequence[str]) -> Iterator[Figure]:
    """Yield the path of the hand in each trial, all in one frame; it is one figure that is drawn anew."""
    *corners_m, aspect = _frame(panels)
    size_in = min(plot.WIDTH_IN - 0.75, 4.0 / aspect)
    figure = Figure(figsize=(plot.WIDTH_IN, size_in * aspect + 1.15), layout="compressed")
    axes = figure.subplots()
    plot.legend_below(figure, _path_handles(panels))
    for place, panel in enumerate(panels):
        axes.clear()
        _draw_path(axes, panel, *corners_m)
        axes.set(xlabel=labels[0], ylabel=labels[1])
        if place == 0:
            figure.draw_without_rendering()
            figure.set_layout_engine("none")  # so that nothing jumps from one to the next
        yield figure


def _path_handles(panels: Sequence[PathPanel]) -> list[Line2D]:
    return [
        plot.key("desired", color=plot.INK, linestyle=plot.DOTS, linewidth=1.0),
        plot.key("actual", color=plot.BLUE, linewidth=1.0),
        plot.key("equilibrium point (EP)", color=plot.GREY, linewidth=1.4),
        plot.key("start", **_START),
        *plot.broken_off(panel.trial for panel in panels),
    ]


def _frame(panels: Sequence[PathPanel]) -> tuple[FloatArray, FloatArray, float]:
    """Return the lower and the upper corner [m] of what all panels show, and its height over its width."""
    everything = np.vstack([each for p in panels for each in (p.desired_m, p.actual_m, p.equilibrium_m)])
    low, high = everything.min(axis=0), everything.max(axis=0)
    margin_m = 0.06 * max(float((high - low).max()), 1e-3)
    low, high = low - margin_m, high + margin_m
    width, height = high - low
    return low, high, float(height / width)


def _tick_distance(extent_m: FloatArray) -> float:
    """Return one distance between ticks for both axes: squares look like squares."""
    tick_m = float(np.diff(MaxNLocator(5, steps=[1, 2, 5, 10]).tick_values(0.0, extent_m.max()))[0])
    half_is_better = extent_m.min() < 2.0 * tick_m and extent_m.max() < 3.5 * tick_m
    return tick_m / 2.0 if half_is_better else tick_m


def _draw_path(axes: Axes, panel: PathPanel, low: FloatArray, high: FloatArray) -> None:
    axes.plot(*panel.equilibrium_m.T, color=plot.GREY, linewidth=1.4)
    axes.plot(*panel.actual_m.T, color=plot.BLUE, linewidth=1.0)
    axes.plot(*panel.desired_m.T, color=plot.INK, linestyle=plot.DOTS, linewidth=1.0, dash_capstyle="butt")
    axes.plot(*panel.actual_m[0], **_START)
    if not panel.trial.completed:
        axes.plot(*panel.actual_m[-1], **plot.BROKEN_OFF)
    axes.set_title(panel.title, linespacing=1.4)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
    tick_m = _tick_distance(high - low)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MultipleLocator(tick_m))


def effort_figure(run: RunData) -> Figure:
    """Return the commanded effort of each joint over the movement, with limits and clipping."""
    figure, panels = movement_panels(run.config.arm.joints)
    clipped = limited = False
    for joint, axes in enumerate(panels):
        for trial, colour in _coloured(run.drawn):
            recorded, time = trial.recorded, movement_time(trial)
            effort_nm = recorded.effort_nm[recorded.run, joint]
            axes.plot(time, effort_nm, color=colour, linewidth=0.9)
            clipped |= plot.mark_saturated(axes, time, effort_nm, recorded.saturated[recorded.run, joint])
        limited |= plot.draw_limit(axes, run.config.arm.effort_limit_nm[joint])
        axes.set_ylabel("torque [N·m]")
    handles = _trial_handles(run.drawn)
    handles += [plot.key("limit", **plot.LIMIT)] if limited else []
    handles += [plot.key("clipped at the limit", **plot.CLIPPED)] if clipped else []
    plot.legend_below(figure, handles)
    return figure


def tracking_figure(drawn: Sequence[DrawnTrial], joints: Sequence[str]) -> Figure:
    """Return measured minus desired position of each joint over the movement.

    A trial whose error the network expected has panels of its own with the band: in one panel, the error of a
    trial before learning or the wider band of a faster one would hide it.
    """
    banded = [each for each in _coloured(drawn) if each[0].is_std_known]
    columns = [(trial_label(each[0].summary).lower(), [each], True) for each in banded]
    if len(banded) < len(drawn):
        numbers = enumeration([str(trial.summary.index) for trial in drawn])
        columns.insert(0, (f"trials {numbers}", _coloured(drawn), False))
    titles = [f"{joint}: {head}" if banded else joint for joint in joints for head, *_ in columns]
    figure, panels = movement_panels(titles, max(2, len(columns)))
    for place, axes in enumerate(panels):
        joint, column = divmod(place, len(columns))
        _, shown, with_band = columns[column]
        for trial, colour in shown:
            if with_band:
                _draw_band(axes, trial, colour, joint)
            draw_error(axes, trial, joint, {}, color=colour, linewidth=1.1)
        if column == 0:
            axes.set_ylabel("actual − desired [rad]")
    handles = [*_trial_handles(drawn), *plot.broken_off(trial.summary for trial in drawn)]
    band = "±2 standard deviations that the network expected of its command"
    bands = [Patch(facecolor=plot.SOFT, alpha=0.3, linewidth=0.0, label=band)] if banded else []
    plot.legend_below(figure, handles, bands)
    return figure


def draw_error(axes: Axes, trial: DrawnTrial, joint: int, mark: dict[str, Any], **style: Any) -> None:
    """Draw measured minus desired position of a joint, and where the trial was broken off if it was."""
    time, error_rad = movement_time(trial), trial.error_rad[:, joint]
    axes.plot(time, error_rad, **style)
    if not trial.summary.completed:
        axes.plot(time[-1], error_rad[-1], **(plot.BROKEN_OFF | mark))


def _draw_band(axes: Axes, trial: DrawnTrial, colour: str, joint: int) -> None:
    half_rad = 2.0 * trial.recorded.command_std_rad[:, joint]
    # An area is written with all of its points, unlike a line, which is simplified.
    rows = evenly_spaced(len(half_rad), 400)
    time, half_rad = movement_time(trial)[rows], half_rad[rows]
    known = np.isfinite(half_rad)
    half_rad = np.where(known, half_rad, 0.0)
    style: dict[str, Any] = {"color": colour, "alpha": 0.2, "linewidth": 0.0, "zorder": 0.8}
    axes.fill_between(time, -half_rad, half_rad, where=known, **style)


def movement_panels(titles: Sequence[str], columns: int = 2) -> tuple[Figure, list[Axes]]:
    """Return a figure with one panel a title over the time of the movement, and the panels row by row."""
    columns = min(columns, len(titles))
    rows = math.ceil(len(titles) / columns)
    figure = Figure(figsize=(plot.WIDTH_IN, min(2.2 * rows + 0.5, 9.7)), layout="constrained")
    grid = figure.subplots(rows, columns, sharex=True, squeeze=False)
    panels = list(grid.flat)[: len(titles)]
    for axes in grid.flat[len(titles) :]:
        axes.remove()
    for place, (axes, title) in enumerate(zip(panels, titles, strict=True)):
        axes.axhline(0.0, color=plot.FAINT, linewidth=0.7, zorder=0.5)
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


def _coloured(drawn: Sequence[DrawnTrial]) -> list[tuple[DrawnTrial, str]]:
    colours = (
        (plot.ORANGE, plot.BLUE) if len(drawn) == 2 else (plot.ORANGE, plot.GREEN, plot.BLUE)[-len(drawn) :]
    )
    return list(zip(drawn, colours, strict=True))


def _trial_handles(drawn: Sequence[DrawnTrial]) -> list[Line2D]:
    return [
        plot.key(f"{trial_label(trial.summary)} ({seconds(trial.summary.duration_s)})", color=colour)
        for trial, colour in _coloured(drawn)
    ]


def practice_figure(run: RunData) -> Figure:
    """Return tracking error, training error and duration over the trials of a run."""
    figure, trials = Figure(figsize=(plot.WIDTH_IN, 2.75), layout="constrained"), run.trials
    tracking, training, duration = figure.subplots(1, 3)
    rms = [t.rms_error_rad for t in trials]
    peak = [t.max_error_rad if t.reached_run else math.nan for t in trials]
    over_trials(
        tracking, trials, [(peak, "largest", plot.ORANGE, "^"), (rms, "RMS", plot.BLUE, "o")], log=True
    )
    tracking.set(title="Tracking error", ylabel="error [rad]")
    before = [t.training_rms_before_rad for t in trials], "before learning", plot.GREEN, "s"
    after = [t.training_rms_after_rad for t in trials], "after", plot.INK, "o"
    over_trials(training, trials, [before, after], log=True)
    training.set(title="Training error (RMS)", ylabel="error of the command [rad]")
    over_trials(duration, trials, [([t.duration_s for t in trials], "", plot.INK, "o")], log=False)
    duration.set(title="Duration of the movement", ylabel="duration [s]")
    duration.set_ylim(0.0, 1.06 * max(trial.duration_s for trial in trials))
    mark = Patch(facecolor=plot.PURPLE, alpha=0.22, label="trial that was not completed")
    plot.legend_below(figure, [] if all(trial.completed for trial in trials) else [mark])
    return figure


def over_trials(
    axes: Axes,
    trials: Sequence[TrialRow],
    series: Sequence[tuple[Sequence[float], str, str, str]],
    *,
    log: bool,
) -> None:
    """Draw series of (values, label, colour, marker) over the numbers of the trials."""
    numbers = [trial.index for trial in trials]
    for trial in trials:
        if not trial.completed:
            axes.axvspan(trial.index - 0.5, trial.index + 0.5, color=plot.PURPLE, alpha=0.22, linewidth=0.0)
    for values, label, colour, marker in series:
        style: dict[str, Any] = {"color": colour, "marker": marker, "label": label or None}
        axes.plot(numbers, values, markersize=3.6, linewidth=1.0, **style)
    known = [value for values, *_ in series for value in values if math.isfinite(value)]
    if log and any(value > 0.0 for value in known):
        plot.scale_errors(axes)
    if not known:
        axes.text(0.5, 0.5, "none", transform=axes.transAxes, ha="center", va="center", color=plot.SOFT)
        axes.set_yticks([])
    axes.set_xlim(min(numbers) - 0.7, max(numbers) + 0.7)
    count_trials(axes)
    if known and any(label for _, label, *_ in series):
        _legend_above(axes, len(series))


def _legend_above(axes: Axes, entries: int) -> None:
    """Put a legend over the curves, in room that is made for it: it covers no marker."""
    columns = 1 if entries < 3 else 2
    legend_in = 0.19 * math.ceil(entries / columns) + 0.12
    share = legend_in / axes.bbox.transformed(axes.figure.dpi_scale_trans.inverted()).height
    scale = axes.yaxis.get_transform()
    low, high = scale.transform(axes.get_ylim())
    axes.set_ylim(top=float(scale.inverted().transform(low + (high - low) / (1.0 - share))))
    axes.legend(loc="upper right", ncols=columns, borderaxespad=0.0)


def count_trials(axes: Axes) -> None:
    """Give the horizontal axis whole numbers, and the vertical one lines behind the curves."""
    axes.xaxis.set_major_locator(MaxNLocator(8, integer=True, min_n_ticks=1))
    axes.set_xlabel("trial")
    axes.grid(axis="y")
    axes.set_axisbelow(True)
