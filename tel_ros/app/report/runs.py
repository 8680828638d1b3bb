"""The report on several practice runs, side by side: its list of sections, and its figures."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from tel_ros import __version__
from tel_ros.app.plotting import (
    BLUE,
    BROKEN_OFF,
    GREEN,
    INK,
    ORANGE,
    PURPLE,
    WIDTH_IN,
    key,
    legend_below,
    scale_errors,
)
from tel_ros.app.report import text
from tel_ros.app.report.data import DrawnTrial, RunData, TrialRow, read_run
from tel_ros.app.report.figures import draw_error, hand_path_figure, movement_panels, path_panels
from tel_ros.app.report.page import Content, Section, block, write_page
from tel_ros.core.errors import InputFileError
from tel_ros.recording.config_file import flat_values

_TEMPLATE = "runs.html.j2"
_COLOURS = (BLUE, ORANGE, GREEN, PURPLE, INK)
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
    def why_not_together(self) -> str:
        """Why the movements of the runs cannot be drawn into one figure; empty: they can."""
        first, first_name = self.runs[0], self.names[0]
        for name, run in zip(self.names, self.runs, strict=True):
            if not run.drawn:
                return f"Nothing to draw: {name} has no trial with a movement and a readable bag."
            for what, differs in (
                ("joints", run.config.arm.joints != first.config.arm.joints),
                ("hand", run.config.arm.hand_link != first.config.arm.hand_link),
                ("URDF", _urdf(run) != _urdf(first)),
            ):
                if differs:
                    return f"Not drawn together: {first_name} and {name} are runs of different arms ({what})."
        return ""


def overview(data: Runs) -> Content:
    """What each run reached, in numbers."""
    rows = [_numbers(run) for run in data.runs]
    return Content(html=block(_TEMPLATE, "overview", names=data.names, runs=data.runs, rows=rows))


def errors(data: Runs) -> Content:
    """RMS error over trials and over durations."""
    return Content(
        errors_figure(data.names, [run.trials for run in data.runs]),
        "RMS tracking error over all joints, trial by trial (left) and over the duration of the movement "
        "(right).",
    )


def hand_path(data: Runs) -> Content:
    """Path of the hand in the last trial of each run."""
    if data.why_not_together:
        return Content(caption=data.why_not_together)
    panels, plane, labels = path_panels([run.drawn[-1] for run in data.runs], data.runs[0].chain)
    named = zip(data.names, panels, strict=True)
    panels = [replace(panel, title=f"{name}\n{panel.title}") for name, panel in named]
    caption = f"The last trial of each run. {text.path_caption(plane)}"
    return Content(hand_path_figure(panels, labels), caption)


def tracking(data: Runs) -> Content:
    """Error of each joint over the last movement of each run."""
    if data.why_not_together:
        return Content(caption=data.why_not_together)
    last = [run.drawn[-1] for run in data.runs]
    return Content(
        last_trials_figure(data.names, data.runs[0].config.arm.joints, last),
        "Tracking error of each joint over the movement, in the last trial of each run.",
    )


def configurations(data: Runs) -> Content:
    """Keys of the configuration in which the runs differ."""
    return Content(html=block(_TEMPLATE, "differences", names=data.names, differences=differences(data.runs)))


SECTIONS: tuple[Section[Runs], ...] = (
    Section("runs", "Results", overview),
    Section("errors", "Errors", errors, "errors"),
    Section("hand-path", "Path of the hand", hand_path, "hand_path"),
    Section("tracking", "Tracking error of the joints", tracking, "tracking"),
    Section("differences", "Where the configurations differ", configurations),
)


def write_runs_report(folders: Sequence[Path], out: Path, formats: Sequence[str] = ("png",)) -> Path:
    """Write ``report.html`` and its figures on two or more runs into a folder, and return the page's path.

    Raises:
        InputFileError: a run is given twice, there are too many, one cannot be read, or ``out`` is the folder
            of a run or cannot be written.
    """
    _require_different(folders, out)
    data = Runs(_names(folders), tuple(map(read_run, folders)))
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputFileError(out, f"cannot be written ({error.strerror})", "room for a report") from error
    return write_page(
        out,
        SECTIONS,
        data,
        formats,
        title=f"{len(folders)} practice runs",
        header=block(_TEMPLATE, "header", names=data.names, runs=data.runs),
        footer=f"Made by tel_ros {__version__} from the bags and the summaries of the runs.",
    )


def errors_figure(names: Sequence[str], trials: Sequence[Sequence[TrialRow]]) -> Figure:
    """Return the RMS error of several runs, over their trials and over the duration of the movement."""
    figure = Figure(figsize=(WIDTH_IN, 3.0), layout="constrained")
    over_trials, over_durations = figure.subplots(1, 2, sharey=True)
    for look, rows in zip(_looks(len(trials)), trials, strict=True):
        moved = [row for row in rows if row.reached_run]
        for axes, place in ((over_trials, "index"), (over_durations, "duration_s")):
            axes.plot([getattr(row, place) for row in moved], [row.rms_error_rad for row in moved], **look)
            for row in (row for row in moved if not row.completed):
                axes.plot(getattr(row, place), row.rms_error_rad, **(BROKEN_OFF | {"markersize": 8.0}))
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
    """Return the tracking error of each joint in the last trial of several runs of an arm."""
    figure, panels = movement_panels(joints)
    for joint, axes in enumerate(panels):
        for look, trial in zip(_looks(len(last)), last, strict=True):
            draw_error(axes, trial, joint, {"markeredgecolor": look["color"]}, **(look | {"marker": ""}))
        axes.set_ylabel("actual − desired [rad]")
    legend_below(figure, "constrained", _legend(names, not all(trial.summary.completed for trial in last)))
    return figure


def _looks(n_runs: int) -> list[dict[str, Any]]:
    """Return the line style of each run."""
    widths = np.linspace(_WIDEST, 1.0, n_runs).tolist() if n_runs > 1 else [1.0]
    looks = [(colour, marker, line) for marker, line in _MARKS for colour in _COLOURS]
    return [
        {"color": colour, "marker": marker, "linestyle": line, "linewidth": width, "markersize": 2.6 + width}
        for (colour, marker, line), width in zip(looks, widths, strict=False)
    ]


def _legend(names: Sequence[str], broken: bool) -> list[list[Any]]:
    """Return rows of entries."""
    entries = [key(name, **look) for look, name in zip(_looks(len(names)), names, strict=True)]
    if broken:
        entries.append(key("broken off", **BROKEN_OFF))
    return [entries[first : first + _LEGEND_COLUMNS] for first in range(0, len(entries), _LEGEND_COLUMNS)]


def differences(runs: Sequence[RunData]) -> dict[str, list[str]]:
    """Return the keys of the configuration in which runs differ, with each run's value."""
    flat = [flat_values(run.config) for run in runs]
    if len({_urdf(run) for run in runs}) == 1:  # each run has a copy of its own
        flat = [{key: value for key, value in values.items() if key != "arm.urdf"} for values in flat]
    keys = dict.fromkeys(key for values in flat for key in values)
    found = {key: [values.get(key, "(not there)") for values in flat] for key in keys}
    table = {key: ["–" if v in ("", None, []) else str(v) for v in values] for key, values in found.items()}
    return {key: shown for key, shown in table.items() if len(set(shown)) > 1}


def _numbers(run: RunData) -> dict[str, float]:
    """Return what came out of a run; NaN where there is no number."""
    moved = [trial for trial in run.trials if trial.reached_run]
    first, last = (moved[0], moved[-1]) if moved else (None, None)
    return {
        "first_duration_s": first.duration_s if first else math.nan,
        "last_duration_s": last.duration_s if last else math.nan,
        "first_rms_rad": first.rms_error_rad if first else math.nan,
        # Half a movement has no best error.
        "best_rms_rad": min((t.rms_error_rad for t in moved if t.completed), default=math.nan),
        "last_rms_rad": last.rms_error_rad if last else math.nan,
        "last_max_rad": last.max_error_rad if last else math.nan,
        "max_effort_nm": max((effort for trial in moved for effort in trial.max_effort_nm), default=math.nan),
    }


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


def _urdf(run: RunData) -> bytes:
    return Path(run.config.arm.urdf).read_bytes()
