"""The command ``tel compare``."""

from __future__ import annotations

import os
import shlex
from pathlib import Path

import click

from tel_lab.study import ending_in_one_line
from tel_ros.app.config_argument import config_argument, overrides_option
from tel_ros.app.tables import show


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
@overrides_option("Another value for a key.")
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
    # Late: other commands do without the learners, which take seconds to load.
    from tel_lab.comparison import comparison_table as shown
    from tel_lab.comparison.method_runs import Task
    from tel_lab.comparison.method_runs import compare as compare_methods

    names = tuple(name.strip() for name in methods.split(",") if name.strip())
    with ending_in_one_line():
        if out is not None:
            with shown.writing_to(out):
                pass
        comparison = compare_methods(Task(config_file, overrides, trials), names, seeds, jobs)
        if out is not None:
            options = [f"--seeds {seeds}", f"--trials {trials}"]
            options += [f"--methods {','.join(names)}"] if names else []
            options += [f"--set {shlex.quote(text)}" for text in overrides]
            asked = f"tel compare {shlex.quote(str(config_file))} {' '.join(options)}"
            shown.write_files(comparison, out, asked)
    if as_json:
        click.echo(shown.json_text(comparison))
        return
    show(shown.table(comparison).terminal(), shown.GIVEN_NOTE, shown.speed_text(comparison))
    if out is not None:
        show(f"written to {out}")
