"""The command ``tel bag export``."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from tel_ros.app.errors import EXIT_BAD_INPUT, EXIT_NOT_COMPLETED, end
from tel_ros.core.errors import TelError

if TYPE_CHECKING:
    from tel_ros.recording.export.run_export import Export


@click.command("export")
@click.argument("path", metavar="RUN|BAG", type=click.Path(path_type=Path))
@click.option(
    "--out",
    required=True,
    type=click.Path(path_type=Path),
    help="Folder to make for the file and the layouts.",
)
@click.option(
    "--json", "as_json", is_flag=True, help="Print what was written as JSON, and nothing else, on stdout."
)
def export_command(path: Path, out: Path, as_json: bool) -> None:
    """Put a run, or one trial, into one MCAP file for Foxglove and PlotJuggler, with a layout for each.

    All recorded messages are in it as they are, trial after trial; besides, what a view in space needs:
    /robot_description, /tf and /tf_static, paths of the hand, the error, the limits of effort. The
    description is the recorded one: files of meshes that it names do not come along.

    Times are the recorded ones. Where those go back from one trial to the next, as after a simulated arm was
    started again, the trial and all that follow it are moved to 1 s behind the trial before it; stamps inside
    the recorded messages stay.

    Trials that are not whole, or never closed, are left out.

    Exit codes: 0 done, 1 done, but a trial was left out, 2 wrong input.
    """
    # Late: `tel --help` needs none of it.
    from tel_ros.app.export_layouts import write_layouts
    from tel_ros.app.report import page_environment
    from tel_ros.recording.export.run_export import export

    try:
        environment = page_environment()  # first: without its library nothing is to be written
        made = export(path, out)
        layouts = write_layouts(made, environment)
    except TelError as error:
        end(str(error), EXIT_BAD_INPUT)
    if as_json:
        click.echo(json.dumps(_plain(made, layouts), indent=2))
    else:
        _tell(made, layouts)
    for bag, problem in made.left_out.items():
        click.echo(f"tel: {bag.name} is left out: it {problem}", err=True)
    sys.exit(EXIT_NOT_COMPLETED if made.left_out else 0)


def _plain(made: Export, layouts: tuple[Path, Path]) -> dict[str, Any]:
    return {
        "folder": str(made.folder),
        "file": str(made.file),
        "foxglove_layout": str(layouts[0]),
        "plotjuggler_layout": str(layouts[1]),
        "trials": [{**vars(trial), "bag": str(trial.bag)} for trial in made.trials],
        "left_out": [{"bag": str(bag), "problem": problem} for bag, problem in made.left_out.items()],
        "topics": made.counts,
        "meshes": list(made.arm.meshes),
    }


def _tell(made: Export, layouts: tuple[Path, Path]) -> None:
    for trial in made.trials:
        moved = f", moved by {trial.shift_s:+.3f} s" if trial.shift_s else ""
        click.echo(f"trial {trial.index:3d}  {trial.begin_s:.3f} s to {trial.end_s:.3f} s{moved}")
    if made.arm.meshes:
        click.echo(
            f"the arm's description names {len(made.arm.meshes)} files of meshes; they do not come along"
        )
    for file in (made.file, *layouts):
        click.echo(file)
