"""Figures of one bag: a trial with what was desired, done and commanded, or joint states as they are."""

from __future__ import annotations

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

from tel_ros.app import plotting as plot
from tel_ros.app.bag.text import trial_text
from tel_ros.app.report.text import seconds
from tel_ros.app.templates import template
from tel_ros.core.errors import BagError, InputFileError, TelError, counted
from tel_ros.core.trial import Phase
from tel_ros.recording.bag_inspection import inspect_bag
from tel_ros.recording.config_file import config_from
from tel_ros.recording.joint_states import RecordedStates, read_joint_states
from tel_ros.recording.run_folder import write_atomically
from tel_ros.recording.trial_bag import RecordedTrial, read_trial

FORMATS = (".png", ".svg", ".pdf", ".html")


def plot_bag(bag: Path, out: Path, topic: str = "") -> str:
    """Write the figure of a bag into a file of whatever format, and return a note about it, mostly empty.

    ``topic``: of joint states to draw, even from a bag of a trial; empty: the trial, or the only topic.
    BagError: the bag has nothing to draw. InputFileError: the format is unknown, or the file cannot be
    written.
    """
    if out.suffix not in FORMATS:
        raise InputFileError(out, f"ends in {out.suffix or 'nothing'}", f"an ending {', '.join(FORMATS)}")
    with plot.figure_style("bag"):
        figure, note = _figure(bag, topic)
        try:
            if out.suffix == ".html":
                name, svg = bag.resolve().name, plot.inline_svg(figure, "bag")
                page = template("bag_plot.html.j2").render(name=name, palette=plot.PALETTE, svg=svg)
                write_atomically(out, page + "\n")
            else:
                plot.save_figure(figure, out)
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
    """Return position, error and torque of each joint over time; ``limits_nm`` None: unknown."""
    figure, rows = _grid(trial.joints, ("position [rad]", "actual − desired [rad]", "torque [N·m]"), title)
    time_s, n = trial.time_s, len(trial.joints)
    # In APPROACH there is no desired position yet.
    on_the_way = (trial.phase == Phase.APPROACH)[:, np.newaxis]
    desired = np.where(on_the_way, np.nan, trial.desired[:, :n])
    stopped = trial.phase == Phase.STOP, plot.PURPLE, 0.12
    around = ~trial.run & ~stopped[0], plot.FAINT, 0.45
    clipped = limited = False
    for joint, (position, error, torque) in enumerate(rows):
        for axes in (position, error, torque):
            for where, colour, alpha in (around, stopped):
                for first, end in plot.stretches(where):
                    until_s = time_s[min(end, len(time_s) - 1)]
                    shade: dict[str, Any] = {"color": colour, "alpha": alpha, "linewidth": 0.0, "zorder": 0.1}
                    axes.axvspan(time_s[first], until_s, **shade)
        desired_rad, actual_rad = desired[:, joint], trial.position_rad[:, joint]
        position.plot(time_s, trial.equilibrium_rad[:, joint], color=plot.GREY, linewidth=1.3)
        position.plot(time_s, actual_rad, color=plot.BLUE, linewidth=1.2)
        position.plot(time_s, desired_rad, color=plot.INK, linestyle=plot.DOTS, linewidth=1.1)
        for axes in (error, torque):
            axes.axhline(0.0, color=plot.FAINT, linewidth=0.7, zorder=0.5)
        error.plot(time_s, actual_rad - desired_rad, color=plot.ORANGE, linewidth=1.0)
        effort_nm = trial.effort_nm[:, joint]
        torque.plot(time_s, effort_nm, color=plot.GREEN, linewidth=0.9)
        clipped |= plot.mark_saturated(torque, time_s, effort_nm, trial.saturated[:, joint])
        if limits_nm is not None:
            limited |= plot.draw_limit(torque, limits_nm[joint])
    for axes in rows[n - 1]:
        axes.set_xlabel("time since the movement began [s]")
    curves = [
        plot.key("desired", color=plot.INK, linestyle=plot.DOTS, linewidth=1.1),
        plot.key("actual", color=plot.BLUE),
        plot.key("equilibrium point (EP)", color=plot.GREY, linewidth=1.3),
        plot.key("error", color=plot.ORANGE),
        plot.key("torque", color=plot.GREEN),
    ]
    if limited:
        curves.append(plot.key("limit", **plot.LIMIT))
    marks: list[Line2D | Patch] = []
    if not trial.run.all():
        label = "on the way to the start, or holding the end"
        marks.append(Patch(facecolor=around[1], alpha=around[2], label=label))
    if stopped[0].any():
        marks.append(Patch(facecolor=stopped[1], alpha=stopped[2], label="stopped"))
    if clipped:
        marks.append(plot.key("torque held back", **plot.CLIPPED))
    plot.legend_below(figure, curves, marks)
    return figure


def states_figure(states: RecordedStates, title: str) -> Figure:
    """Return position, velocity and effort of each joint over time, without those that were not published."""
    kinds = [
        ("position [rad]", plot.BLUE, states.position_rad),
        ("velocity [rad/s]", plot.ORANGE, states.velocity_rad_s),
        ("effort [N·m]", plot.GREEN, states.effort_nm),
    ]
    told = [kind for kind in kinds if np.isfinite(kind[2]).any()] or kinds[:1]
    figure, rows = _grid(states.joints, [label for label, *_ in told], title)
    for joint, row in enumerate(rows):
        for axes, (_, colour, values) in zip(row, told, strict=True):
            axes.plot(states.time_s, values[:, joint], color=colour, linewidth=0.9)
    for axes in rows[-1]:
        axes.set_xlabel("time [s]")
    return figure


def _grid(joints: Sequence[str], labels: Sequence[str], title: str) -> tuple[Figure, list[list[Axes]]]:
    """Return axes with a row for each joint and a column for each label."""
    figure = Figure(figsize=(10.5, 1.6 * len(joints) + 1.1), layout="constrained")  # for a screen
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
