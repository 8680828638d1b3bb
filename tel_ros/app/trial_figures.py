"""The figures of a report that go over the trials of a run."""

from __future__ import annotations

import math
from collections.abc import Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter

from tel_ros.app.figure_export import BLUE, GREEN, INK, ORANGE, PURPLE, SOFT
from tel_ros.app.figures import WIDTH_IN, legend_below
from tel_ros.app.report_data import TrialSummary


def practice_figure(trials: Sequence[TrialSummary]) -> Figure:
    """Return tracking error, training error and duration over the trials of a run."""
    figure = Figure(figsize=(WIDTH_IN, 2.75), layout="constrained")
    tracking, training, duration = figure.subplots(1, 3)
    rms = [t.rms_error_rad for t in trials]
    peak = [t.max_error_rad if t.reached_run else math.nan for t in trials]
    before = [t.training_rms_before_rad for t in trials]
    after = [t.training_rms_after_rad for t in trials]
    over_trials(tracking, trials, [(peak, "largest", ORANGE, "^"), (rms, "RMS", BLUE, "o")], log=True)
    tracking.set(title="Tracking error", ylabel="error [rad]")
    over_trials(
        training, trials, [(before, "before learning", GREEN, "s"), (after, "after", INK, "o")], log=True
    )
    training.set(title="Training error (RMS)", ylabel="error of the command [rad]")
    over_trials(duration, trials, [([t.duration_s for t in trials], "", INK, "o")], log=False)
    duration.set(title="Duration of the movement", ylabel="duration [s]")
    duration.set_ylim(bottom=0.0)
    if not all(trial.completed for trial in trials):
        mark = Patch(facecolor=PURPLE, alpha=0.22, label="trial that was not completed")
        legend_below(figure, "constrained", [[mark]])
    return figure


def over_trials(
    axes: Axes,
    trials: Sequence[TrialSummary],
    series: Sequence[tuple[Sequence[float], str, str, str]],
    *,
    log: bool,
) -> None:
    """Draw series of (values, label, colour, marker) over the numbers of the trials."""
    numbers = [trial.index for trial in trials]
    for trial in trials:
        if not trial.completed:
            axes.axvspan(trial.index - 0.5, trial.index + 0.5, color=PURPLE, alpha=0.22, linewidth=0.0)
    for values, label, colour, marker in series:
        axes.plot(
            numbers, values, color=colour, marker=marker, markersize=3.6, linewidth=1.0, label=label or None
        )
    known = [value for values, *_ in series for value in values if math.isfinite(value)]
    if log and any(value > 0.0 for value in known):
        scale_errors(axes)
    if not known:
        axes.text(0.5, 0.5, "none", transform=axes.transAxes, ha="center", va="center", color=SOFT)
        axes.set_yticks([])
    axes.set_xlim(min(numbers) - 0.7, max(numbers) + 0.7)
    axes.xaxis.set_major_locator(MaxNLocator(8, integer=True, min_n_ticks=1))
    axes.set_xlabel("trial")
    axes.grid(axis="y")
    axes.set_axisbelow(True)
    if known and any(label for _, label, *_ in series):
        axes.legend(loc="best")


def scale_errors(axes: Axes) -> None:
    """Give the vertical axis decades, and numbers that need no exponent to be read."""
    axes.set_yscale("log")
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0), numticks=12))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:.10g}"))
    axes.yaxis.set_minor_formatter(NullFormatter())
