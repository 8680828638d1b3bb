"""The command ``tel configs``."""

from __future__ import annotations

import json

import click
from rich import box
from rich.console import Console
from rich.table import Table

from tel_ros.app.errors import EXIT_BAD_INPUT, end
from tel_ros.core.errors import TelError
from tel_ros.recording.shared_files import config_folder, shipped_configs, summary_of


@click.command()
@click.option("--json", "as_json", is_flag=True, help="Print names, files and texts as JSON on stdout.")
def configs(as_json: bool) -> None:
    """List the configurations that come with tel.

    Their names can be given wherever a command takes CONFIG: `tel practice paper`. To change more than a few
    keys (--set), copy a file from the folder that this prints, together with the arm that it names.
    """
    try:
        files, folder = shipped_configs(), config_folder()
    except TelError as error:
        end(str(error), EXIT_BAD_INPUT)
    rows = [{"name": name, "file": str(file), "about": summary_of(file)} for name, file in files.items()]
    if as_json:
        click.echo(json.dumps(rows, indent=2))
        return
    table = Table(box=box.SIMPLE_HEAD)
    for heading in ("name", "about"):
        table.add_column(heading, overflow="fold")
    for row in rows:
        table.add_row(row["name"], row["about"])
    console = Console()
    console.print(table)
    console.print(f"folder  {folder}", highlight=False, soft_wrap=True)
