"""Figures of one bag: a trial with what was wanted, done and commanded, or joint states as they are."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from tel_ros.app.figure_export import BLUE, FAINT, GREEN, GREY, INK, ORANGE, PURPLE, SOFT
from tel_ros.app.figures import DOTS, draw_limit, legend_below, mark_saturated
from tel_ros.core.trial import Phase
from tel_ros.core.types import BoolArray, FloatArray
from tel_ros.recording.joint_states import RecordedStates
from tel_ros.recording.trial_bag import RecordedTrial

WIDTH_IN = 10.5
"""For a screen, not for a column of a paper."""
_ROW_IN, _REST_IN = 1.6, 1.1
_DRAWN_POINTS = 3000
"""Of a curve: more than a figure has pixels."""
_TITLE_LETTERS = 125
_AROUND_ALPHA = 0.45


def trial_figure(trial: RecordedTrial, limits_nm: Sequence[float] | None, title: str) -> Figure:
    """Return position, tracking error and torque of each joint over the time of a trial.

    Args:
        trial: as recorded.
        limits_nm: effort limits, one for each joint; None: unknown.
        title: of the figure.
    """
    figure, rows = _grid(trial.joints, ("position [rad]", "actual − desired [rad]", "torque [N·m]"), title)
    time_s, n = trial.time_s, len(trial.joints)
    # On the way to the start it is the equilibrium point that is moved; there is no desired position yet.
    on_the_way = (trial.phase == Phase.APPROACH)[:, np.newaxis]
    desired = np.where(on_the_way, np.nan, trial.desired[:, :n])
    clipped = limited = False
    for joint, (position, error, torque) in enumerate(rows):
        for axes in (position, error, torque):
            _shade(axes, time_s, ~trial.run & (trial.phase != Phase.STOP), FAINT, _AROUND_ALPHA)
            _shade(axes, time_s, trial.phase == Phase.STOP, PURPLE, 0.12)
        desired_rad, actual_rad = desired[:, joint], trial.position_rad[:, joint]
        _curve(position, time_s, trial.equilibrium_rad[:, joint], color=GREY, linewidth=1.3)
        _curve(position, time_s, actual_rad, color=BLUE, linewidth=1.2)
        _curve(position, time_s, desired_rad, color=INK, linestyle=DOTS, linewidth=1.1)
        error.axhline(0.0, color=FAINT, linewidth=0.7, zorder=0.5)
        _curve(error, time_s, actual_rad - desired_rad, color=ORANGE, linewidth=1.0)
        torque.axhline(0.0, color=FAINT, linewidth=0.7, zorder=0.5)
        effort_nm = trial.effort_nm[:, joint]
        _curve(torque, time_s, effort_nm, color=GREEN, linewidth=0.9)
        clipped |= mark_saturated(torque, time_s, effort_nm, trial.saturated[:, joint])
        if limits_nm is not None:
            limited |= draw_limit(torque, limits_nm[joint])
    for axes in rows[n - 1]:
        axes.set_xlabel("time since the movement began [s]")
    curves = [
        Line2D([], [], color=INK, linestyle=DOTS, linewidth=1.1, label="desired"),
        Line2D([], [], color=BLUE, label="actual"),
        Line2D([], [], color=GREY, linewidth=1.3, label="equilibrium point (EP)"),
        Line2D([], [], color=ORANGE, label="error"),
        Line2D([], [], color=GREEN, label="torque"),
    ]
    if limited:
        curves.append(Line2D([], [], color=SOFT, linestyle="--", linewidth=0.9, label="limit"))
    marks: list[Line2D | Patch] = []
    if not trial.run.all():
        label = "on the way to the start, or holding the end"
        marks.append(Patch(facecolor=FAINT, alpha=_AROUND_ALPHA, label=label))
    if (trial.phase == Phase.STOP).any():
        marks.append(Patch(facecolor=PURPLE, alpha=0.12, label="stopped"))
    if clipped:
        marks.append(Line2D([], [], color=PURPLE, linewidth=4.0, alpha=0.55, label="torque held back"))
    legend_below(figure, "constrained", [curves, marks] if marks else [curves])
    return figure


def states_figure(states: RecordedStates, title: str) -> Figure:
    """Return position, velocity and effort of each joint over time, without what nobody told."""
    kinds = [
        ("position [rad]", BLUE, states.position_rad),
        ("velocity [rad/s]", ORANGE, states.velocity_rad_s),
        ("effort [N·m]", GREEN, states.effort_nm),
    ]
    told = [kind for kind in kinds if np.isfinite(kind[2]).any()] or kinds[:1]
    figure, rows = _grid(states.joints, [label for label, *_ in told], title)
    for joint, row in enumerate(rows):
        for axes, (_, colour, values) in zip(row, told, strict=True):
            _curve(axes, states.time_s, values[:, joint], color=colour, linewidth=0.9)
    for axes in rows[-1]:
        axes.set_xlabel("time [s]")
    return figure


def thinned(time_s: FloatArray, values: FloatArray, most: int) -> tuple[FloatArray, FloatArray]:
    """Return a curve of at most about so many points that looks the same: extremes of each stretch stay.

    Args:
        time_s: shape (n,).
        values: shape (n,); NaN for gaps.
        most: points to keep; at least 2.
    """
    if len(values) <= most:
        return time_s, values
    width = math.ceil(len(values) / (most // 2))
    padding = -len(values) % width
    stretches = np.pad(values, (0, padding), constant_values=np.nan).reshape(-1, width)
    gaps = np.isnan(stretches)
    first = width * np.arange(len(stretches))
    kept = np.concatenate(
        [
            [0, len(values) - 1],
            first + np.where(gaps, np.inf, stretches).argmin(axis=1),
            first + np.where(gaps, -np.inf, stretches).argmax(axis=1),
            (first + gaps.argmax(axis=1))[gaps.any(axis=1)],
        ]
    )
    places = np.unique(kept[kept < len(values)])
    return time_s[places], values[places]


def _grid(joints: Sequence[str], labels: Sequence[str], title: str) -> tuple[Figure, list[list[Axes]]]:
    """Return axes with a row for each joint and a column for each label."""
    height = _ROW_IN * len(joints) + _REST_IN
    figure = Figure(figsize=(WIDTH_IN, height), layout="constrained")
    lines = [part for line in title.splitlines() for part in textwrap.wrap(line, _TITLE_LETTERS)]
    figure.suptitle("\n".join(lines), x=0.01, ha="left", fontsize=9.5, linespacing=1.5)
    grid = figure.subplots(len(joints), len(labels), sharex=True, squeeze=False)
    for joint, row in zip(joints, grid, strict=True):
        for axes, label in zip(row, labels, strict=True):
            axes.set_title(joint)
            axes.set_ylabel(label)
            axes.yaxis.set_major_locator(MaxNLocator(5, steps=[1, 2, 5, 10]))
            axes.margins(x=0.01)
    return figure, [list(row) for row in grid]


def _curve(axes: Axes, time_s: FloatArray, values: FloatArray, **style: object) -> None:
    axes.plot(*thinned(time_s, values, _DRAWN_POINTS), **style)


def _shade(axes: Axes, time_s: FloatArray, where: BoolArray, colour: str, alpha: float) -> None:
    """Shade the times at which something is so."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], where, [False]]).astype(int)))
    for first, end in edges.reshape(-1, 2):
        until = time_s[min(end, len(time_s) - 1)]
        axes.axvspan(time_s[first], until, color=colour, alpha=alpha, linewidth=0.0, zorder=0.1)
