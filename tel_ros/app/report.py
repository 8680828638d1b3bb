"""The report of a practice run: one HTML file that needs nothing beside it, and its figures as files."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tel_ros import __version__
from tel_ros.app import report_text
from tel_ros.app.extensions import extensions, load
from tel_ros.app.report_data import RunData, read_drawable, read_run
from tel_ros.app.report_figure import FigureMaker, ReportFigure
from tel_ros.app.report_steps import MOST_STEPS, path_steps
from tel_ros.core.errors import InputFileError, TelError
from tel_ros.core.kinematics import SerialChain
from tel_ros.recording.run_folder import CONFIG_FILE, REPORT_FILE, SUMMARY_FILE, write_atomically
from tel_ros.recording.urdf import chain_to_hand, read_urdf

if TYPE_CHECKING:
    import jinja2

_TEMPLATES = Path(__file__).parent / "templates"
_TEMPLATE = "report.html.j2"


def write_report(folder: Path, formats: Sequence[str] = ("png",)) -> Path:
    """Write ``report.html`` and the figures of a practice run into its folder.

    Args:
        folder: of the run.
        formats: of the files of the figures; those of an earlier report in other formats are removed.

    Returns:
        The path of the HTML file.

    Raises:
        InputFileError: the folder is not that of a run with at least one trial, or cannot be written.
        TelError: a library that reports need is not installed.
    """
    require_report_libraries()
    run = read_run(folder)
    file, maker = folder / REPORT_FILE, FigureMaker(folder, formats)
    try:
        theory = _theory(run)
        content = _content(run, theory, _figures(run, maker) | {"theory": _theory_figure(run, theory, maker)})
        content["steps"] = path_steps(read_drawable(run, MOST_STEPS), _chain(run)) if run.drawn else []
        page = page_environment().get_template(_TEMPLATE).render(content, text=report_text)
        write_atomically(file, page + "\n")
    except OSError as error:
        raise InputFileError(
            error.filename or folder, f"cannot be written ({error.strerror})", "room for a report"
        ) from error
    return file


def require_report_libraries() -> None:
    """Complain if a library that reports need is not installed.

    Raises:
        TelError: one is not.
    """
    try:
        import jinja2  # noqa: F401
        import matplotlib  # noqa: F401 - only to know whether it is there
    except ModuleNotFoundError as error:
        raise TelError(
            f"a report needs {error.name}, which is not installed: pip install 'tel_ros[report]'"
        ) from error


def page_environment() -> jinja2.Environment:
    """Return what renders pages from the templates beside this module."""
    import jinja2

    return jinja2.Environment(
        loader=jinja2.FileSystemLoader(_TEMPLATES),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )


def _content(run: RunData, theory: Any, figures: dict[str, ReportFigure]) -> dict[str, Any]:
    from tel_ros.app.figure_export import PALETTE

    written = datetime.fromtimestamp((run.folder / SUMMARY_FILE).stat().st_mtime).astimezone()
    return {
        "run": run,
        "name": run.folder.resolve().name,
        "joints": run.config.arm.joints,
        "figures": figures,
        "theory": theory,
        "palette": PALETTE,
        "date": f"{written:%Y-%m-%d %H:%M}",
        "configuration": (run.folder / CONFIG_FILE).read_text(encoding="utf-8"),
        "version": __version__,
    }


def _figures(run: RunData, maker: FigureMaker) -> dict[str, ReportFigure]:
    from tel_ros.app import figures, trial_figures

    arm = run.config.arm
    made = {
        "practice": maker.make(
            "practice",
            lambda: trial_figures.practice_figure(run.trials),
            "Errors and durations of all trials. Tracking error: measured minus desired joint position, over "
            "all joints. Training error: what the network gets wrong about the commands of the trial just "
            "done, before and after it has learned from it.",
        )
    }
    if not run.drawn:
        nothing = "Nothing to draw: there is no trial with a movement and a readable bag."
        return made | {name: maker.missing(name, nothing) for name in ("hand_path", "effort", "tracking")}
    panels, plane, labels = figures.path_panels(run.drawn, _chain(run))
    return made | {
        "hand_path": maker.make(
            "hand_path", lambda: figures.hand_path_figure(panels, labels), report_text.path_caption(plane)
        ),
        "effort": maker.make(
            "effort",
            lambda: figures.effort_figure(run.drawn, arm.joints, arm.effort_limit_nm),
            "Commanded torque of each joint over the movement, after clipping to the effort limit. A limit "
            "that is far off the scale is named instead of drawn.",
        ),
        "tracking": maker.make(
            "tracking",
            lambda: figures.tracking_figure(run.drawn, arm.joints),
            report_text.tracking_caption(run.drawn),
        ),
    }


def _chain(run: RunData) -> SerialChain:
    arm = run.config.arm
    return chain_to_hand(read_urdf(Path(arm.urdf)), arm.joints, arm.hand_link)


def _theory(run: RunData) -> Any:
    """Return what the theorems say of a run, as far as the package that measures them is installed."""
    place = extensions("tel_ros.report").get("theory")
    return load(place)(run) if place else None


def _theory_figure(run: RunData, theory: Any, maker: FigureMaker) -> ReportFigure:
    if theory is None:
        return maker.missing("theory", "The theorems are not measured: tel_lab is not installed.")
    if not theory.estimates:
        return maker.missing("theory", theory.missing)
    return maker.make(
        "theory",
        theory.figure,
        "What the paper's theorems speak of. Left: the command error that the tracking error comes from, "
        "which on an arm can only be estimated, and what Theorem 3 allows a step in speed to add to it. "
        "Right: training helps for certain only where k_R is below 1. Near 1 the network is taught where the "
        "arm goes, not where it should go. " + theory.missing,
    )
