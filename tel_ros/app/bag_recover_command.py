"""The command ``tel bag recover``."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import click

from tel_ros.app.errors import EXIT_BAD_INPUT, end
from tel_ros.core.errors import TelError
from tel_ros.recording.recover import recover


@click.command("recover")
@click.argument("unfinished", type=click.Path(path_type=Path))
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    help="Folder of the new bag (default: recovered/NAME in the folder of the run).",
)
@click.option(
    "--json", "as_json", is_flag=True, help="Print what was saved as JSON, and nothing else, on stdout."
)
def recover_command(unfinished: Path, out: Path | None, as_json: bool) -> None:
    """Save what a crash has left of a recording.

    UNFINISHED is a folder below a run's .unfinished; it stays as it is. Everything up to the last whole chunk
    goes into a new bag, which is marked as recovered: it can be looked at, but nothing is trained on it.
    """
    try:
        found = recover(unfinished, out)
    except TelError as error:
        end(str(error), EXIT_BAD_INPUT)
    if as_json:
        values = {**asdict(found), "bag": str(found.bag), "unfinished": str(unfinished)}
        click.echo(json.dumps(values, indent=2))
        return
    for topic, n in found.counts.items():
        click.echo(f"{n:8d}  {topic}")
    click.echo(f"{found.lost_bytes} bytes behind the last whole chunk are lost")
    click.echo("the trial had ended" if found.has_result else "the end of the trial is missing")
    click.echo(f"recovered into {found.bag}, from {unfinished}")
