"""The report on several practice runs, side by side: its list of sections, and its figures."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from tel_ros import __version__
from tel_ros.app import plotting as plot
from tel_ros.app.report import figures, text
from tel_ros.app.report.data import DrawnTrial, RunData, TrialRow, read_run
from tel_ros.app.report.page import Content, Section, block, write_page
from tel_ros.core.errors import InputFileError
from tel_ros.recording.config_file import flat_values

_TEMPLATE = "runs.html.j2"
_COLOURS = (plot.BLUE, plot.ORANGE, plot.GREEN, plot.PURPLE, plot.INK)
_MARKS = (("o", "-"), ("s", "--"))
MOST_RUNS = len(_COLOURS) * len(_MARKS)
"""More cannot be told apart."""
_WIDEST = 3.0
"""Each run is drawn thinner than the one before, so that equal curves are seen as two."""
_LEGEND_COLUMNS = 3


@dataclass(frozen=True)
class Runs:
    """Several runs with their names."""

    names: tuple[str, ...]
    runs: tuple[RunData, ...]

    @property
    def why_not_drawn(self) -> str:
        """Why the movements of the runs cannot be drawn into one figure; empty: they can."""
        first, first_name = self.runs[0], self.names[0]
        for name, run in zip(self.names, self.runs, strict=True):
            if not run.drawn:
                return f"Nothing to draw: {name} has no trial with a movement and a readable bag."
            for what, differs in (
                ("joints", run.config.arm.joints != first.config.arm.joints),
                ("hand", run.config.arm.hand_link != first.config.arm.hand_link),
                ("URDF", run.urdf != first.urdf),
            ):
                if differs:
                    return f"Not drawn together: {first_name} and {name} are runs of different arms ({what})."
        return ""

    @property
    def last(self) -> list[DrawnTrial]:
        """The last trial of each run that can be drawn."""
        return [run.drawn[-1] for run in self.runs]

    @property
    def looks(self) -> list[dict[str, Any]]:
        """Line style of each run."""
        n = len(self.runs)
        widths = np.linspace(_WIDEST, 1.0, n).tolist() if n > 1 else [1.0]
        marks = [{"color": c, "marker": m, "linestyle": line} for m, line in _MARKS for c in _COLOURS]
        sized = zip(marks, widths, strict=False)
        return [mark | {"linewidth": width, "markersize": 2.6 + width} for mark, width in sized]


def hand_path(data: Runs) -> Content:
    """Path of the hand in the last trial of each run."""
    panels, plane, labels = figures.path_panels(data.last, data.runs[0].chain)
    named = zip(data.names, panels, strict=True)
    panels = [replace(panel, title=f"{name}\n{panel.title}") for name, panel in named]
    caption = f"The last trial of each run. {text.path_caption(plane)}"
    return Content(figures.hand_path_figure(panels, labels), caption)


def _table(macro: str, **more: Callable[[Runs], Any]) -> Callable[[Runs], Content]:
    return lambda data: Content(
        html=block(_TEMPLATE, macro, names=data.names, **{name: value(data) for name, value in more.items()})
    )


def errors_figure(data: Runs) -> Figure:
    """Return the RMS error of several runs, over their trials and over the duration of the movement."""
    figure, rows = Figure(figsize=(plot.WIDTH_IN, 3.0), layout="constrained"), []
    over_trials, over_durations = figure.subplots(1, 2, sharey=True)
    for look, run in zip(data.looks, data.runs, strict=True):
        moved = [row for row in run.trials if row.reached_run]
        rows += moved
        for axes, place in ((over_trials, "index"), (over_durations, "duration_s")):
            axes.plot([getattr(row, place) for row in moved], [row.rms_error_rad for row in moved], **look)
            for row in (row for row in moved if not row.completed):
                axes.plot(getattr(row, place), row.rms_error_rad, **(plot.BROKEN_OFF | {"markersize": 8.0}))
    if any(row.rms_error_rad > 0.0 for row in rows):
        plot.scale_errors(over_trials)
    figures.count_trials(over_trials)
    over_trials.set(title="Trial by trial", ylabel="RMS error [rad]")
    over_durations.grid(axis="y")
    over_durations.set_axisbelow(True)
    over_durations.set(title="At each speed: faster to the right", xlabel="duration of the movement [s]")
    over_durations.invert_xaxis()
    plot.legend_below(figure, *_legend(data, rows))
    return figure


def last_trials_figure(data: Runs) -> Figure:
    """Return the tracking error of each joint in the last trial of several runs of an arm."""
    figure, panels = figures.movement_panels(data.runs[0].config.arm.joints)
    for joint, axes in enumerate(panels):
        for look, trial in zip(data.looks, data.last, strict=True):
            figures.draw_error(
                axes, trial, joint, {"markeredgecolor": look["color"]}, **(look | {"marker": ""})
            )
        axes.set_ylabel("actual − desired [rad]")
    plot.legend_below(figure, *_legend(data, [trial.summary for trial in data.last]))
    return figure


def _legend(data: Runs, trials: Sequence[TrialRow]) -> list[list[Line2D]]:
    entries = [plot.key(name, **look) for look, name in zip(data.looks, data.names, strict=True)]
    entries += plot.broken_off(trials)
    return [entries[first : first + _LEGEND_COLUMNS] for first in range(0, len(entries), _LEGEND_COLUMNS)]


SECTIONS: tuple[Section[Runs], ...] = (
    Section("runs", "Results", _table("overview", runs=lambda data: data.runs)),
    Section(
        "errors",
        "Errors",
        errors_figure,
        "errors",
        "RMS tracking error over all joints, trial by trial (left) and over the duration of the movement "
        "(right).",
    ),
    Section("hand-path", "Path of the hand", hand_path, "hand_path", of_movements=True),
    Section(
        "tracking",
        "Tracking error of the joints",
        last_trials_figure,
        "tracking",
        "Tracking error of each joint over the movement, in the last trial of each run.",
        of_movements=True,
    ),
    Section(
        "differences",
        "Where the configurations differ",
        _table("differences", differences=lambda data: differences(data.runs)),
    ),
)


def write_runs_report(folders: Sequence[Path], out: Path, formats: Sequence[str] = ("png",)) -> Path:
    """Write ``report.html`` and its figures on two or more runs into a folder, and return the page's path.

    InputFileError: a run is given twice or cannot be read, they are too many, or ``out`` is one of them or
    cannot be written.
    """
    _require_different(folders, out)
    data = Runs(_names(folders), tuple(map(read_run, folders)))
    page = write_page(
        out,
        SECTIONS,
        data,
        formats,
        title=f"{len(folders)} practice runs",
        header=block(_TEMPLATE, "header", names=data.names, runs=data.runs),
        footer=f"Made by tel_ros {__version__} from the bags and the summaries of the runs.",
    )
    for run in data.runs:
        run.require_bags(page)
    return page


def differences(runs: Sequence[RunData]) -> dict[str, list[str]]:
    """Return the keys of the configuration in which runs differ, with each run's value."""
    flat = [flat_values(run.config) for run in runs]
    if len({run.urdf for run in runs}) == 1:  # each run has a copy of its own
        flat = [{key: value for key, value in values.items() if key != "arm.urdf"} for values in flat]
    keys = dict.fromkeys(key for values in flat for key in values)
    found = {key: [values.get(key, "(not there)") for values in flat] for key in keys}
    table = {key: ["–" if v in ("", None, []) else str(v) for v in values] for key, values in found.items()}
    return {key: shown for key, shown in table.items() if len(set(shown)) > 1}


def _require_different(folders: Sequence[Path], out: Path) -> None:
    resolved = [folder.resolve() for folder in folders]
    for place, folder in enumerate(resolved):
        if folder in resolved[:place]:
            raise InputFileError(folders[place], "is given twice", "different runs")
    if len(folders) > MOST_RUNS:
        raise InputFileError(folders[MOST_RUNS], f"is run {MOST_RUNS + 1}", f"at most {MOST_RUNS} runs")
    if out.resolve() in resolved:
        raise InputFileError(out, "is the folder of a run, which has a report of its own", "another folder")


def _names(folders: Sequence[Path]) -> tuple[str, ...]:
    """Return the shortest ends of the folders' paths that differ."""
    parts = [folder.resolve().parts for folder in folders]
    for length in range(1, max(map(len, parts))):
        names = tuple("/".join(part[-length:]) for part in parts)
        if len(set(names)) == len(names):
            return names
    return tuple(map(str, folders))
