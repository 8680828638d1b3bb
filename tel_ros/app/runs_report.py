"""A report on several practice runs, side by side: one HTML file that needs nothing beside it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from tel_ros import __version__
from tel_ros.app import report_text
from tel_ros.app.report import page_environment, require_report_libraries
from tel_ros.app.report_data import RunData, read_run
from tel_ros.app.report_figure import FigureMaker, ReportFigure
from tel_ros.core.errors import InputFileError
from tel_ros.recording.config_file import flat_values
from tel_ros.recording.run_folder import REPORT_FILE, write_atomically
from tel_ros.recording.urdf import chain_to_hand, read_urdf

_TEMPLATE = "runs.html.j2"
_UNSET = "(not there)"


def write_runs_report(folders: Sequence[Path], out: Path, formats: Sequence[str] = ("png",)) -> Path:
    """Write ``report.html`` and its figures on several runs into a folder.

    Args:
        folders: of the runs, at least two.
        out: the folder; is made if it is missing.
        formats: of the files of the figures.

    Returns:
        The path of the HTML file.

    Raises:
        InputFileError: a run is given twice, there are too many, one cannot be read, or ``out`` is the folder
            of a run or cannot be written.
        TelError: a library that reports need is not installed.
    """
    require_report_libraries()
    _require_different(folders, out)
    runs = [read_run(folder) for folder in folders]
    names = _names(folders)
    try:
        out.mkdir(parents=True, exist_ok=True)
        content = {
            "names": names,
            "runs": runs,
            "rows": [_row(run) for run in runs],
            "differences": differences(runs),
            "figures": _figures(names, runs, FigureMaker(out, formats)),
            "palette": _palette(),
            "version": __version__,
        }
        page = page_environment().get_template(_TEMPLATE).render(content, text=report_text)
        write_atomically(out / REPORT_FILE, page + "\n")
    except OSError as error:
        raise InputFileError(
            error.filename or out, f"cannot be written ({error.strerror})", "room for a report"
        ) from error
    return out / REPORT_FILE


def differences(runs: Sequence[RunData]) -> dict[str, list[str]]:
    """Return the keys of the configuration in which runs differ, with each run's value."""
    flat = [flat_values(run.config) for run in runs]
    if len({_urdf(run) for run in runs}) == 1:  # each run has a copy of its own
        flat = [{key: value for key, value in values.items() if key != "arm.urdf"} for values in flat]
    keys = list(dict.fromkeys(key for values in flat for key in values))
    table = {key: [_shown(values[key]) if key in values else _UNSET for values in flat] for key in keys}
    return {key: shown for key, shown in table.items() if len(set(shown)) > 1}


def _row(run: RunData) -> dict[str, float]:
    """Return what came out of a run, in numbers; NaN where there is none."""
    moved = [trial for trial in run.trials if trial.reached_run]
    completed = [trial for trial in moved if trial.completed]
    first, last = (moved[0], moved[-1]) if moved else (None, None)
    return {
        "first_duration_s": first.duration_s if first else math.nan,
        "last_duration_s": last.duration_s if last else math.nan,
        "first_rms_rad": first.rms_error_rad if first else math.nan,
        # Half a movement has no best error.
        "best_rms_rad": min((trial.rms_error_rad for trial in completed), default=math.nan),
        "last_rms_rad": last.rms_error_rad if last else math.nan,
        "last_max_rad": last.max_error_rad if last else math.nan,
        "max_effort_nm": max((effort for trial in moved for effort in trial.max_effort_nm), default=math.nan),
    }


def _shown(value: Any) -> str:
    return "–" if value in ("", None, []) else str(value)


def _require_different(folders: Sequence[Path], out: Path) -> None:
    from tel_ros.app.runs_figures import MOST_RUNS

    resolved = [folder.resolve() for folder in folders]
    for place, folder in enumerate(resolved):
        if folder in resolved[:place]:
            raise InputFileError(folders[place], "is given twice", "different runs")
    if len(folders) > MOST_RUNS:
        raise InputFileError(folders[MOST_RUNS], f"is run {MOST_RUNS + 1}", f"at most {MOST_RUNS} runs")
    if out.resolve() in resolved:
        raise InputFileError(out, "is the folder of a run, which has a report of its own", "another folder")


def _names(folders: Sequence[Path]) -> list[str]:
    """Return the shortest ends of the folders' paths that differ."""
    parts = [folder.resolve().parts for folder in folders]
    for length in range(1, max(map(len, parts))):
        names = ["/".join(part[-length:]) for part in parts]
        if len(set(names)) == len(names):
            return names
    return [str(folder) for folder in folders]


def _palette() -> dict[str, tuple[str, str]]:
    from tel_ros.app.figure_export import PALETTE

    return PALETTE


def _figures(names: Sequence[str], runs: Sequence[RunData], maker: FigureMaker) -> dict[str, ReportFigure]:
    from tel_ros.app import figures, runs_figures

    made = {
        "errors": maker.make(
            "errors",
            lambda: runs_figures.errors_figure(names, [run.trials for run in runs]),
            "RMS tracking error over all joints, trial by trial (left) and at the speed at which it was made "
            "(right).",
        )
    }
    why = _why_not_together(names, runs)
    if why:
        return made | {name: maker.missing(name, why) for name in ("hand_path", "tracking")}
    arm, last = runs[0].config.arm, [run.drawn[-1] for run in runs]
    chain = chain_to_hand(read_urdf(Path(arm.urdf)), arm.joints, arm.hand_link)
    panels, plane, labels = figures.path_panels(last, chain)
    panels = [
        replace(panel, title=f"{name}\n{panel.title}") for name, panel in zip(names, panels, strict=True)
    ]
    return made | {
        "hand_path": maker.make(
            "hand_path",
            lambda: figures.hand_path_figure(panels, labels),
            f"The last trial of each run. {report_text.path_caption(plane)}",
        ),
        "tracking": maker.make(
            "tracking",
            lambda: runs_figures.last_trials_figure(names, arm.joints, last),
            "Tracking error of each joint over the movement, in the last trial of each run.",
        ),
    }


def _why_not_together(names: Sequence[str], runs: Sequence[RunData]) -> str:
    """Return why the movements of the runs cannot be drawn into one figure; empty: they can."""
    for name, run in zip(names, runs, strict=True):
        if not run.drawn:
            return f"Nothing to draw: {name} has no trial with a movement and a readable bag."
        for what, value, first in (
            ("joints", run.config.arm.joints, runs[0].config.arm.joints),
            ("hand", run.config.arm.hand_link, runs[0].config.arm.hand_link),
            ("URDF", _urdf(run), _urdf(runs[0])),
        ):
            if value != first:
                return f"Not drawn together: {names[0]} and {name} are runs of different arms ({what})."
    return ""


def _urdf(run: RunData) -> bytes:
    return Path(run.config.arm.urdf).read_bytes()
