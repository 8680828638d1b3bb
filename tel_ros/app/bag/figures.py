"""Figures of one bag: a trial with what was desired, done and commanded, or joint states as they are."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from tel_ros.app.bag.text import trial_text
from tel_ros.app.plotting import (
    BLUE,
    CLIPPED,
    DOTS,
    FAINT,
    GREEN,
    GREY,
    INK,
    LIMIT,
    ORANGE,
    PALETTE,
    PURPLE,
    draw_limit,
    figure_style,
    inline_svg,
    key,
    legend_below,
    mark_saturated,
    save_figure,
    stretches,
)
from tel_ros.app.report.text import seconds
from tel_ros.app.templates import template
from tel_ros.core.errors import BagError, InputFileError, TelError, counted
from tel_ros.core.trial import Phase
from tel_ros.core.types import BoolArray, FloatArray
from tel_ros.recording.bag_inspection import inspect_bag
from tel_ros.recording.config_file import config_from
from tel_ros.recording.joint_states import RecordedStates, read_joint_states
from tel_ros.recording.run_folder import write_atomically
from tel_ros.recording.trial_bag import RecordedTrial, read_trial

FORMATS = (".png", ".svg", ".pdf", ".html")
WIDTH_IN = 10.5
"""For a screen, not for a column of a paper."""
_AROUND_ALPHA = 0.45


def plot_bag(bag: Path, out: Path, topic: str = "") -> str:
    """Write the figure of a bag, and return what is to be said about it; mostly nothing.

    Args:
        bag: of a trial, or any with joint states.
        out: the file; its ending says which format.
        topic: of joint states to draw, even from a bag of a trial; empty: the trial, or the only topic.

    Raises:
        BagError: the bag cannot be read, or has nothing to draw.
        InputFileError: the format is unknown, or the file cannot be written.
    """
    if out.suffix not in FORMATS:
        raise InputFileError(out, f"ends in {out.suffix or 'nothing'}", f"an ending {', '.join(FORMATS)}")
    with figure_style("bag"):
        figure, note = _figure(bag, topic)
        try:
            if out.suffix == ".html":
                name, svg = bag.resolve().name, inline_svg(figure, "bag")
                page = template("bag_plot.html.j2").render(name=name, palette=PALETTE, svg=svg)
                write_atomically(out, page + "\n")
            else:
                save_figure(figure, out)
        except OSError as error:
            raise InputFileError(out, f"cannot be written ({error.strerror})", "room for it") from error
    return note


def _figure(bag: Path, topic: str) -> tuple[Figure, str]:
    inspected = inspect_bag(bag)
    if inspected.trial is not None and not topic and bag.is_dir():
        trial = read_trial(bag, recovered=True)
        if not len(trial.time_ns):
            raise BagError(bag, "holds no control state of its trial", "some to draw; or --topic")
        limits_nm, note = _limits(trial)
        name = f"{bag.resolve().parent.name}/{bag.resolve().name}"
        return trial_figure(trial, limits_nm, f"{name}\ntrial {trial_text(inspected.trial)}"), note
    states = read_joint_states(bag, topic)
    title = f"{bag.resolve().name}: {states.topic}, {counted(len(states.time_s), 'joint state')} in "
    title += seconds(float(states.time_s[-1]))
    note = "" if inspected.wholeness.is_good else f"the bag is {inspected.wholeness.value}"
    return states_figure(states, title), note


def _limits(trial: RecordedTrial) -> tuple[tuple[float, ...] | None, str]:
    """Return the effort limits that are stored with a trial, or why there are none."""
    try:
        arm = config_from(yaml.safe_load(trial.metadata["config"])).arm
        places = [arm.joints.index(joint) for joint in trial.joints]
        return tuple(arm.effort_limit_nm[place] for place in places), ""
    except (TelError, yaml.YAMLError, KeyError, ValueError, TypeError) as error:
        return None, f"the figure has no effort limits: the bag's configuration cannot be used ({error})"


def trial_figure(trial: RecordedTrial, limits_nm: Sequence[float] | None, title: str) -> Figure:
    """Return position, tracking error and torque of each joint over the time of a trial.

    ``limits_nm`` are the effort limits of the joints; None: unknown.
    """
    figure, rows = _grid(trial.joints, ("position [rad]", "actual − desired [rad]", "torque [N·m]"), title)
    time_s, n = trial.time_s, len(trial.joints)
    # In APPROACH there is no desired position yet.
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
        for axes in (error, torque):
            axes.axhline(0.0, color=FAINT, linewidth=0.7, zorder=0.5)
        _curve(error, time_s, actual_rad - desired_rad, color=ORANGE, linewidth=1.0)
        effort_nm = trial.effort_nm[:, joint]
        _curve(torque, time_s, effort_nm, color=GREEN, linewidth=0.9)
        clipped |= mark_saturated(torque, time_s, effort_nm, trial.saturated[:, joint])
        if limits_nm is not None:
            limited |= draw_limit(torque, limits_nm[joint])
    for axes in rows[n - 1]:
        axes.set_xlabel("time since the movement began [s]")
    curves = [
        key("desired", color=INK, linestyle=DOTS, linewidth=1.1),
        key("actual", color=BLUE),
        key("equilibrium point (EP)", color=GREY, linewidth=1.3),
        key("error", color=ORANGE),
        key("torque", color=GREEN),
    ]
    if limited:
        curves.append(key("limit", **LIMIT))
    marks: list[Line2D | Patch] = []
    if not trial.run.all():
        label = "on the way to the start, or holding the end"
        marks.append(Patch(facecolor=FAINT, alpha=_AROUND_ALPHA, label=label))
    if (trial.phase == Phase.STOP).any():
        marks.append(Patch(facecolor=PURPLE, alpha=0.12, label="stopped"))
    if clipped:
        marks.append(key("torque held back", **CLIPPED))
    legend_below(figure, curves, marks)
    return figure


def states_figure(states: RecordedStates, title: str) -> Figure:
    """Return position, velocity and effort of each joint over time, without those that were not published."""
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
    """Return a curve (NaN for gaps) of about ``most`` points, at least 2: extremes of each stretch stay."""
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
    figure = Figure(figsize=(WIDTH_IN, 1.6 * len(joints) + 1.1), layout="constrained")
    lines = [part for line in title.splitlines() for part in textwrap.wrap(line, 125)]
    figure.suptitle("\n".join(lines), x=0.01, ha="left", fontsize=9.5, linespacing=1.5)
    grid = figure.subplots(len(joints), len(labels), sharex=True, squeeze=False)
    for joint, row in zip(joints, grid, strict=True):
        for axes, label in zip(row, labels, strict=True):
            axes.set_title(joint)
            axes.set_ylabel(label)
            axes.yaxis.set_major_locator(MaxNLocator(5, steps=[1, 2, 5, 10]))
            axes.margins(x=0.01)
    return figure, [list(row) for row in grid]


def _curve(axes: Axes, time_s: FloatArray, values: FloatArray, **style: Any) -> None:
    axes.plot(*thinned(time_s, values, 3000), **style)  # more than a figure has pixels


def _shade(axes: Axes, time_s: FloatArray, where: BoolArray, colour: str, alpha: float) -> None:
    """Shade the times at which something is so."""
    for first, end in stretches(where):
        until = time_s[min(end, len(time_s) - 1)]
        axes.axvspan(time_s[first], until, color=colour, alpha=alpha, linewidth=0.0, zorder=0.1)
