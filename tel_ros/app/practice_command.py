"""``tel practice``, and how it shows a run while it goes on."""

from __future__ import annotations

import json
import math
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from tel_ros.app.command_group import missing_module
from tel_ros.app.config_argument import ConfigFile, namespace_option, overrides_option
from tel_ros.app.errors import (
    EXIT_BAD_INPUT,
    EXIT_GRAPH_FAILED,
    EXIT_INTERRUPTED,
    EXIT_NOT_COMPLETED,
    GraphError,
    Interrupted,
    Interruption,
    end,
)
from tel_ros.app.tables import show, trial_table
from tel_ros.app.view.command import beside_run, view_option
from tel_ros.core.errors import TelError, counted
from tel_ros.core.trial import Outcome
from tel_ros.recording.config_file import load_config
from tel_ros.recording.run_folder import read_summary

if TYPE_CHECKING:
    from tel_interfaces.action import Practice

    from tel_ros.recording.resumption import Resumption

_PROGRESS = Console(stderr=True)


@click.command()
@click.argument("config_file", metavar="[CONFIG]", required=False, type=ConfigFile())
@overrides_option("Another value for a key, e.g. sim.clock=realtime.")
@click.option(
    "--resume",
    "resumed",
    metavar="RUN",
    type=click.Path(path_type=Path),
    help="Go on with the interrupted run in this folder; without CONFIG, --set and --out.",
)
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    help="Folder of the run; must not exist. Default: bags/NAME-TIME.",
)
@click.option("--json", "as_json", is_flag=True, help="Print summary.json, and nothing else, on stdout.")
@click.option(
    "--report/--no-report", "with_report", default=True, help="Make the report at the end (default)."
)
@namespace_option
@view_option
def practice(
    config_file: Path | None,
    overrides: tuple[str, ...],
    resumed: Path | None,
    out: Path | None,
    as_json: bool,
    with_report: bool,
    namespace: str,
    with_view: bool,
) -> None:
    """Run a practice run: bring the node graph up, practise, take it down.

    CONFIG is a YAML file, or the name of one that `tel configs` lists. The run's folder gets a bag for each
    trial, the learned network, run.yaml, summary.json and report.html. A run that was interrupted goes on
    with --resume.
    """
    if resumed is None and config_file is None:
        end("nothing to practise: expected CONFIG, or --resume RUN", EXIT_BAD_INPUT)
    ignored = {"--set": overrides, "--out": out, f"CONFIG ({config_file})": config_file}
    if resumed is not None and any(ignored.values()):
        given = ", ".join(name for name, value in ignored.items() if value)
        expected = f"--resume {resumed} alone: a run goes on as its run.yaml says, into its own folder"
        end(f"{given} given with --resume; expected {expected}", EXIT_BAD_INPUT)
    Interruption.watch()
    # Imported late: `tel --help` and `tel report` need no ROS.
    from tel_ros.nodes.robot_description import description_in  # isort: skip - first: whether ROS can start
    from tel_ros.app.practice import practise, resume

    try:
        beside = beside_run(with_view, _PROGRESS, namespace)
        if resumed is not None:
            folder = resumed
            with ProgressView(_PROGRESS) as progress:
                told = partial(_say_what_goes_on, folder)
                result = resume(folder, told, progress.update, beside, namespace)
        else:
            assert config_file is not None  # as checked above
            folder = out or Path("bags") / f"{config_file.stem}-{datetime.now():%Y%m%d-%H%M%S}"
            config = load_config(config_file, overrides, partial(description_in, namespace))
            with ProgressView(_PROGRESS) as progress:
                result = practise(config, folder, progress.update, beside, namespace)
    except GraphError as error:
        end(f"{error}{_left(folder)}", error.exit_code)
    except Interruption.errors() as error:
        seen = error if isinstance(error, Interrupted) else "no node was running"
        end(f"interrupted: {seen}{_left(folder)}", EXIT_INTERRUPTED)
    try:
        summary = read_summary(folder)
    except TelError as error:  # a full disk may have left none
        end(f"{result.message or error}{_left(folder)}", EXIT_GRAPH_FAILED)
    _show(summary, folder, as_json)
    if with_report and summary["trials"]:
        _report_at_the_end(folder, as_json)
    if result.outcome != "completed":
        code = EXIT_GRAPH_FAILED if result.outcome == "failed" else EXIT_NOT_COMPLETED
        end(f"{result.message}{_left(folder)}", code)


def _report_at_the_end(folder: Path, as_json: bool) -> None:
    """Make the report of a run that has ended; if that fails, the run is still what it was."""
    try:
        from tel_ros.app.report.run import write_report  # imported late: plotting takes a second to import

        file = write_report(folder)
    except (TelError, ModuleNotFoundError) as error:
        why = missing_module(error) if isinstance(error, ModuleNotFoundError) else str(error)
        click.echo(f"tel: no report: {why} (`tel report {folder}` makes it later)", err=True)
        return
    if not as_json:
        click.echo(f"report  {file}")


def _show(summary: dict, folder: Path, as_json: bool) -> None:
    if as_json:
        click.echo(json.dumps(summary, indent=2))
        return
    trials = summary["trials"]
    show(trial_table(trials))
    warned = [trial for trial in trials if trial["warning"]]
    if warned:  # the last one is based on most trials
        click.echo(f"note    trial {warned[-1]['index']}: {warned[-1]['warning']}")
    irregular = [trial for trial in trials if trial["timing"] and trial["timing"]["warning"]]
    if irregular:
        last = f"trial {irregular[-1]['index']}: {irregular[-1]['timing']['warning']} (docs/realtime.md)"
        share = f"{len(irregular)} of {counted(len(trials), 'trial')}"
        click.echo(f"note    {share} had bad timing, the last one: {last}")
    if summary["outcome"] == "completed" and summary["message"]:
        click.echo(f"result  {summary['message']}")
    click.echo(f"run     {folder}")


def _left(folder: Path) -> str:
    """Return where to find what was recorded, if anything was."""
    return f" (what was recorded is in {folder})" if folder.exists() else ""


def _say_what_goes_on(folder: Path, resumption: Resumption) -> None:
    """Say on stderr what a run goes on from, and where the rest was put."""
    for path, why in resumption.set_aside.items():
        click.echo(f"set aside  {path} ({why})", err=True)
    click.echo(f"resumed    {folder} after {counted(resumption.trials, 'whole trial')}", err=True)


class ProgressView:
    """A line that moves on a terminal; in a log file one line a trial. Use it with ``with``."""

    def __init__(self, console: Console) -> None:
        self._print = partial(console.print, highlight=False, soft_wrap=True, markup=False)
        self._progress = Progress(
            TextColumn("{task.description}"),
            BarColumn(bar_width=24),
            TextColumn("{task.percentage:3.0f} %"),
            TimeElapsedColumn(),
            TextColumn("left"),
            TimeRemainingColumn(elapsed_when_finished=False),
            console=console,
            transient=True,
            disable=not console.is_terminal,
        )
        self._task = self._progress.add_task("starting the nodes", total=1.0)

    def __enter__(self) -> ProgressView:
        """Show the line."""
        self._progress.start()
        return self

    def __exit__(self, *error: object) -> None:
        """Take the line away."""
        self._progress.stop()

    def update(self, feedback: Practice.Feedback) -> None:
        """Take in a message about the progress of the run."""
        # A strategy that gives reasons decides as it goes: how many trials it will be is a guess.
        about = "~" if feedback.reason else ""
        trial = f"trial {feedback.trial:2d}/{about}{feedback.trials}  α {feedback.alpha:.3f}"
        text = f"{trial}  {feedback.stage:<10}"
        if not math.isnan(feedback.max_error_rad):
            text += f"  error up to {feedback.max_error_rad:.3f} rad"
        self._progress.update(self._task, description=text, completed=feedback.progress)
        for result in feedback.last:
            before, after = feedback.training_rms_rad
            words = [trial, f"{feedback.duration_s:6.3f} s"]
            if not math.isnan(result.rms_error_rad):
                words.append(f"error {result.rms_error_rad:.4f} rad RMS, {result.max_error_rad:.3f} max")
            if not math.isnan(after):
                words.append(f"training {before:.4f} → {after:.4f}")
            why = f": {result.message}" if result.message else ""
            if not why and feedback.reason:
                why = f" ({feedback.reason})"
            words.append(f"{Outcome(result.outcome).text}{why}")
            left_s = self._progress.tasks[0].time_remaining
            if left_s is not None:
                words.append(f"about {left_s:.0f} s left")
            self._print("  ".join(words))
            if result.timing_warning:
                self._print(f"{trial}  {result.timing_warning}")
