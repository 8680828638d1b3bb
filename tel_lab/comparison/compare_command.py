"""The command ``tel compare``."""

from __future__ import annotations

import os
import shlex
import signal
from pathlib import Path

import click
from rich.console import Console

from tel_ros.app.config_argument import config_argument
from tel_ros.app.errors import EXIT_BAD_INPUT, EXIT_INTERRUPTED, EXIT_NOT_COMPLETED, end
from tel_ros.core.errors import TelError


@click.command()
@config_argument
@click.option("--methods", default="", metavar="A,B,…", help="Methods to compare. Default: all.")
@click.option(
    "--seeds", default=10, show_default=True, help="Arms, each with its masses, friction and noise."
)
@click.option("--trials", default=15, show_default=True, help="Budget of every method.")
@click.option("--jobs", default=os.cpu_count() or 1, show_default="one a core", help="Processes at a time.")
@click.option(
    "--out",
    type=click.Path(path_type=Path, file_okay=False),
    help="Folder for comparison.csv, .json, .md, .svg and .png; files of these names in it are replaced.",
)
@click.option("--json", "as_json", is_flag=True, help="Print comparison.json, and nothing else, on stdout.")
@click.option("--set", "overrides", metavar="KEY=VALUE", multiple=True, help="Another value for a key.")
def compare(
    config_file: Path,
    methods: str,
    seeds: int,
    trials: int,
    jobs: int,
    out: Path | None,
    as_json: bool,
    overrides: tuple[str, ...],
) -> None:
    """Compare practice with other ways to learn the movement of CONFIG.

    Every method practises on the same simulated arms, which differ in masses, friction and noise, and has the
    same number of trials; then it is tested on the practised path and on one that it has never seen. Nothing
    of ROS runs.
    """
    from tel_lab.comparison.comparison_table import GIVEN_NOTE, json_text, speed_text, table, write_files
    from tel_lab.comparison.method_runs import RunFailedError, Task
    from tel_lab.comparison.method_runs import compare as compare_methods
    from tel_lab.comparison.results import MethodRun

    def show(run: MethodRun, done: int, total: int) -> None:
        click.echo(f"{done:3d}/{total}  arm {run.seed}  {run.method}", err=True)

    # SIGINT as well: where a script has started this in the background, it would be ignored.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.default_int_handler)
    names = tuple(name.strip() for name in methods.split(",") if name.strip())
    try:
        task = Task(config_file, overrides, trials)
        comparison = compare_methods(task, names, seeds, jobs, show)
    except RunFailedError as error:
        end(str(error), EXIT_NOT_COMPLETED)
    except TelError as error:
        end(str(error), EXIT_BAD_INPUT)
    except KeyboardInterrupt:
        end("interrupted", EXIT_INTERRUPTED)
    if out is not None:
        options = [f"--seeds {seeds}", f"--trials {trials}"]
        options += [f"--methods {','.join(names)}"] if names else []
        options += [f"--set {shlex.quote(text)}" for text in overrides]
        try:
            write_files(comparison, out, f"tel compare {shlex.quote(str(config_file))} {' '.join(options)}")
        except TelError as error:
            end(str(error), EXIT_BAD_INPUT)
    if as_json:
        click.echo(json_text(comparison))
        return
    console = Console()
    console.print(table(comparison).terminal())
    console.print(GIVEN_NOTE, highlight=False)
    console.print(speed_text(comparison), highlight=False)
    if out is not None:
        console.print(f"written to {out}", highlight=False, soft_wrap=True)
