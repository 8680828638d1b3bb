"""The report of one practice run. A new figure is a function and an entry in the list of sections."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any

from markupsafe import Markup

from tel_ros import __version__
from tel_ros.app.command_group import extensions, load
from tel_ros.app.plotting import inline_svg
from tel_ros.app.report import figures, text
from tel_ros.app.report.data import RunData, TrialRow, read_drawable, read_run
from tel_ros.app.report.limits import limits
from tel_ros.app.report.page import Content, Section, block, write_page
from tel_ros.recording.run_folder import SUMMARY_FILE

MOST_STEPS = 16
_STEP_POINTS = 400
"""Points of a curve in the section that steps through the trials."""
_TEMPLATE = "run.html.j2"


def hand_path(run: RunData) -> Content:
    """[Practice] Fig. 2 of the first, the middle and the last trial."""
    panels, plane, labels = figures.path_panels(run.drawn, run.chain)
    return Content(figures.hand_path_figure(panels, labels), text.path_caption(plane))


def steps(run: RunData) -> Content | None:
    """The path of the hand in one trial after the other, to step through; None for a single trial."""
    trials = read_drawable(run, MOST_STEPS) if run.drawn else []
    if len(trials) < 2:
        return None
    panels, _, labels = figures.path_panels(trials, run.chain, _STEP_POINTS)
    indices = [trial.summary.index for trial in trials]
    pictures = [
        (index, Markup(inline_svg(figure, f"step-{index}")))
        for index, figure in zip(indices, figures.path_pictures(panels, labels), strict=True)
    ]
    return Content(html=block(_TEMPLATE, "steps", pictures=pictures))


def tracking(run: RunData) -> Content:
    """Error of each joint over the movement."""
    return Content(
        figures.tracking_figure(run.drawn, run.config.arm.joints), text.tracking_caption(run.drawn)
    )


def _table(
    macro: str, is_known: Callable[[TrialRow], Any] = lambda trial: True
) -> Callable[[RunData], Content | None]:
    """Return what makes a section of a macro alone, left out if nothing is known of any trial."""
    return lambda run: (
        Content(html=block(_TEMPLATE, macro, run=run)) if any(map(is_known, run.trials)) else None
    )


FIGURES: tuple[Section[RunData], ...] = (
    Section("hand-path", "Path of the hand", hand_path, "hand_path", of_movements=True),
    Section("steps", "From trial to trial", steps),
    Section(
        "errors",
        "Error and duration of each trial",
        figures.practice_figure,
        "practice",
        "Errors and durations of all trials. Tracking error: measured minus desired joint position, over all "
        "joints. Training error: the network's error on the commands of the trial just done, before and "
        "after it has learned from it.",
    ),
    Section(
        "torques",
        "Torques",
        figures.effort_figure,
        "effort",
        "Commanded torque of each joint over the movement, after clipping to the effort limit. A limit that "
        "is far off the scale is named instead of drawn.",
        of_movements=True,
    ),
    Section("limits", "How near to the limits", limits, "limits"),
    Section("tracking", "Tracking error of the joints", tracking, "tracking", of_movements=True),
)
"""Of one path: where several were practised, each has them."""
RESULTS: tuple[Section[RunData], ...] = (
    Section("trials", "Trials", _table("trials")),
    Section("timing", "Timing of the control loop", _table("timing", lambda trial: trial.timing)),
    Section("decisions", "Why these trials", _table("decisions", lambda trial: trial.reason)),
)
"""Sections of other packages (entry points of the group ``tel_ros.report_sections``) follow these."""


def _results(run: RunData) -> Iterator[Section[RunData]]:
    """Yield the sections with results."""
    names = run.config.path.names
    if not names:
        yield from (*FIGURES, *RESULTS)
        return
    yield Section("movements", "The movements", _table("movements"))
    for section in FIGURES:
        for k, name in enumerate(names, start=1):
            yield replace(
                section,
                id=f"{section.id}-{k}",
                title=f"{section.title}: {name}",
                content=partial(_of_path, section, name),
                file=section.file and f"{section.file}_{k}",
                of_movements=False,
            )
    yield from RESULTS


def _of_path(section: Section[RunData], name: str, run: RunData) -> Any:
    of_path = run.of_path(name)
    if not of_path.trials:
        return None
    why_not = of_path.why_not_drawn if section.of_movements else ""
    return Content(caption=why_not) if why_not else section.content(of_path)


DETAILS: tuple[Section[RunData], ...] = (
    Section("growth", "What grew in the network", _table("growth")),
    Section("configuration", "Configuration", _table("configuration")),
    Section("versions", "Versions", _table("versions")),
)


def write_report(folder: Path, formats: Sequence[str] = ("png",)) -> Path:
    """Write ``report.html`` and the figures of a practice run into its folder, and return the page's path.

    InputFileError: the folder is not that of a run with at least one trial, or cannot be written; as
    BagError, after the page is written: not one bag can be used.
    """
    run, name = read_run(folder), folder.resolve().name
    date = f"{datetime.fromtimestamp((folder / SUMMARY_FILE).stat().st_mtime).astimezone():%Y-%m-%d %H:%M}"
    others = [load(place) for place in extensions("tel_ros.report_sections").values()]
    page = write_page(
        folder,
        (*_results(run), *others, *DETAILS),
        run,
        formats,
        title=f"Practice run {name}",
        header=block(_TEMPLATE, "header", run=run, date=date),
        footer=f"Made by tel_ros {__version__} from the bags and the summary of the run; the summary is of "
        f"{date}, by the date of its file. Bags that are not drawn were opened, but not read to their end.",
    )
    run.require_bags(page)
    return page
