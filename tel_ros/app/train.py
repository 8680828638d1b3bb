"""The command ``tel train``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from rich.console import Console
from rich.table import Table

from tel_ros.app.errors import EXIT_BAD_INPUT, EXIT_INTERRUPTED, end
from tel_ros.app.import_command import given_options, import_options, run_import
from tel_ros.app.tables import compact_table, number, training_error
from tel_ros.core.errors import TelError

if TYPE_CHECKING:
    from tel_ros.recording.retraining import Retraining


@click.command()
@click.argument("bags", metavar="BAG…", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option(
    "--out",
    required=True,
    type=click.Path(path_type=Path, dir_okay=False),
    help="File of the network, e.g. network.npz.",
)
@click.option("--force", is_flag=True, help="Replace the file if there is one already.")
@click.option(
    "--set",
    "overrides",
    metavar="KEY=VALUE",
    multiple=True,
    help="Another setting of the learner, e.g. learning.weights=least_squares, or seed.",
)
@click.option(
    "--json", "as_json", is_flag=True, help="Print what came out as JSON, and nothing else, on stdout."
)
@click.option("--import", "imports", is_flag=True, help="BAGs are recordings that other programs made.")
@import_options
@click.pass_context
def train(
    context: click.Context,
    /,
    bags: tuple[Path, ...],
    out: Path,
    force: bool,
    overrides: tuple[str, ...],
    as_json: bool,
    imports: bool,
    **import_settings: Any,
) -> None:
    """Rebuild the network from BAGs alone, in the order given.

    A BAG is a trial's folder; the folder of a run stands for all its trials. Everything else that it takes
    is in the bags. With the recorded settings the network becomes, bit for bit, the one that the run has
    left. Bags of different arms are refused, and so are unfinished, recovered and damaged ones. Nothing of
    ROS runs.

    With --import a BAG is any recording with efforts: a bag of ROS 1 or ROS 2 (sqlite3, MCAP; with or without
    metadata.yaml) with sensor_msgs/JointState or trajectory_msgs/JointTrajectory, or a CSV with the columns
    time_s, q_<joint>, tau_<joint>. Torques are learned, and how good they are is told from parts of the
    recording that were held back.
    """
    if imports:
        wrong = {"--set": overrides, "--force": force}
        if given := [name for name, value in wrong.items() if value]:
            raise click.UsageError(f"{' and '.join(given)} cannot be used with --import")
        run_import(bags, out, as_json, **import_settings)
        return
    if given := given_options(context):
        raise click.UsageError(f"{' and '.join(given)} can only be used with --import")
    from tel_ros.recording.retraining import train as train_on  # late: `tel --help` needs no learners

    def show(bag: Path) -> None:
        click.echo(f"learned  {bag}", err=True)

    try:
        retraining = train_on(bags, out, overrides, force=force, on_lesson=show)
    except TelError as error:
        end(str(error), EXIT_BAD_INPUT)
    except KeyboardInterrupt:
        end("interrupted: no network was written", EXIT_INTERRUPTED)
    if as_json:
        click.echo(json.dumps(retraining.as_dict(), indent=2))
        return
    console = Console()
    console.print(_table(retraining))
    lines = [row["note"] and f"note     trial {row['index']}: {row['note']}" for row in retraining.lessons]
    lines += [f"network  {retraining.network}", f"revision {retraining.revision}: {_comparison(retraining)}"]
    for line in filter(None, lines):
        console.print(line, highlight=False, soft_wrap=True, markup=False)


def _comparison(retraining: Retraining) -> str:
    if retraining.as_recorded:
        return "each trial had been commanded by the network that there was here before it"
    if retraining.differs_at:
        return f"not that of the run, {retraining.differs_at} had been commanded by another one"
    return "some bags do not tell which network commanded them"


def _table(retraining: Retraining) -> Table:
    table = compact_table(
        "bag",
        "trial",
        "duration\ns",
        "RMS error\nrad",
        "training error\nbefore → after rad",
        "outcome",
    )
    for row in retraining.lessons:
        table.add_row(
            Path(row["bag"]).name,
            str(row["index"]),
            f"{row['duration_s']:.3f}",
            number(row["rms_error_rad"]),
            training_error(row),
            row["outcome"],
        )
    return table
