"""The figures of a report on several practice runs. None of them reads a file."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from tel_ros.app.figure_export import BLUE, GREEN, INK, ORANGE, PURPLE
from tel_ros.app.figures import BROKEN_OFF, WIDTH_IN, legend_below, movement_panels, movement_time
from tel_ros.app.report_data import DrawnTrial, TrialSummary
from tel_ros.app.trial_figures import scale_errors

_COLOURS = (BLUE, ORANGE, GREEN, PURPLE, INK)
_MARKS = (("o", "-"), ("s", "--"))
MOST_RUNS = len(_COLOURS) * len(_MARKS)
"""More cannot be told apart."""
_WIDEST = 3.0
"""Each run is drawn thinner than the one before, which shows where two are the same."""
_LEGEND_COLUMNS = 3


def errors_figure(names: Sequence[str], trials: Sequence[Sequence[TrialSummary]]) -> Figure:
    """Return the RMS error of several runs, over their trials and over the duration of the movement.

    Args:
        names: of the runs.
        trials: of each run.
    """
    figure = Figure(figsize=(WIDTH_IN, 3.0), layout="constrained")
    over_trials, over_durations = figure.subplots(1, 2, sharey=True)
    for look, rows in zip(_looks(len(trials)), trials, strict=True):
        moved = [row for row in rows if row.reached_run]
        _draw(over_trials, [row.index for row in moved], moved, look)
        _draw(over_durations, [row.duration_s for row in moved], moved, look)
    if any(row.rms_error_rad > 0.0 for rows in trials for row in rows):
        scale_errors(over_trials)
    over_trials.set(title="Trial by trial", xlabel="trial", ylabel="RMS error [rad]")
    over_trials.xaxis.set_major_locator(MaxNLocator(8, integer=True, min_n_ticks=1))
    over_durations.set(title="At each speed: faster to the right", xlabel="duration of the movement [s]")
    over_durations.invert_xaxis()
    for axes in (over_trials, over_durations):
        axes.grid(axis="y")
        axes.set_axisbelow(True)
    broken = any(row.reached_run and not row.completed for rows in trials for row in rows)
    legend_below(figure, "constrained", _legend(names, broken))
    return figure


def last_trials_figure(names: Sequence[str], joints: Sequence[str], last: Sequence[DrawnTrial]) -> Figure:
    """Return the tracking error of each joint in the last trial of several runs of an arm.

    Args:
        names: of the runs.
        joints: of the arm.
        last: one trial a run.
    """
    figure, panels = movement_panels(joints)
    for joint, axes in enumerate(panels):
        for look, trial in zip(_looks(len(last)), last, strict=True):
            time, error_rad = movement_time(trial), trial.error_rad[:, joint]
            axes.plot(time, error_rad, **(look | {"marker": ""}))
            if not trial.summary.completed:
                axes.plot(time[-1], error_rad[-1], **(BROKEN_OFF | {"markeredgecolor": look["color"]}))
        axes.set_ylabel("actual − desired [rad]")
    legend_below(figure, "constrained", _legend(names, not all(trial.summary.completed for trial in last)))
    return figure


def _looks(n_runs: int) -> list[dict[str, Any]]:
    """Return how the curves of each run look."""
    widths = np.linspace(_WIDEST, 1.0, n_runs) if n_runs > 1 else [1.0]
    looks = [(colour, marker, line) for marker, line in _MARKS for colour in _COLOURS]
    return [
        {
            "color": colour,
            "marker": marker,
            "linestyle": line,
            "linewidth": float(width),
            "markersize": 2.6 + float(width),
        }
        for (colour, marker, line), width in zip(looks, widths, strict=False)
    ]


def _draw(axes: Axes, places: Sequence[float], trials: Sequence[TrialSummary], look: dict[str, Any]) -> None:
    axes.plot(places, [trial.rms_error_rad for trial in trials], **look)
    for place, trial in zip(places, trials, strict=True):
        if not trial.completed:
            axes.plot(place, trial.rms_error_rad, **(BROKEN_OFF | {"markersize": 8.0}))


def _legend(names: Sequence[str], broken: bool) -> list[list[Any]]:
    """Return rows of entries."""
    entries = [
        Line2D([], [], **look, label=name) for look, name in zip(_looks(len(names)), names, strict=True)
    ]
    if broken:
        entries.append(Line2D([], [], **BROKEN_OFF, label="broken off"))
    return [entries[first : first + _LEGEND_COLUMNS] for first in range(0, len(entries), _LEGEND_COLUMNS)]
