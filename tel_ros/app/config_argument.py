"""CONFIG of a command (a file, or the name of a shipped one), ``--namespace``, and ``tel configs``."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click
from click.shell_completion import CompletionItem

from tel_ros.app.tables import show, table
from tel_ros.core.errors import TelError
from tel_ros.recording.shared_files import config_folder, named_config, shipped_configs, summary_of

F = TypeVar("F", bound=Callable[..., Any])


class ConfigFile(click.ParamType):
    """A YAML file, or the name of a shipped configuration."""

    name = "config"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """Return the file; one that does not exist is left to the reader, which says so."""
        return named_config(str(value))

    def shell_complete(
        self, ctx: click.Context, param: click.Parameter, incomplete: str
    ) -> list[CompletionItem]:
        """Offer the shipped names, and files."""
        try:
            names = [name for name in shipped_configs() if name.startswith(incomplete)]
        except TelError:
            names = []
        return [*map(CompletionItem, names), CompletionItem(incomplete, type="file")]


config_argument = click.argument("config_file", metavar="CONFIG", type=ConfigFile())
"""CONFIG of a command, which gets it as ``config_file``."""


def overrides_option(about: str) -> Callable[[F], F]:
    """Return the option ``--set``, which a command gets as ``overrides``; ``about`` is its help."""
    return click.option("--set", "overrides", metavar="KEY=VALUE", multiple=True, help=about)


def _full_namespace(context: click.Context, option: click.Parameter, value: str) -> str:
    full = "/" + value.strip("/")
    if full != "/" and not re.fullmatch(r"(/[A-Za-z][A-Za-z0-9_]*)+", full):
        expected = "letters, digits and _, as in left or lab/left"
        raise click.BadParameter(f"{value!r} is no namespace; expected {expected}", context, option)
    return full


namespace_option = click.option(
    "--namespace",
    metavar="NAMESPACE",
    callback=_full_namespace,
    default="/",
    help="ROS namespace of the arm and of all nodes, e.g. left: two arms can practise side by side.",
)


@click.command()
@click.option("--json", "as_json", is_flag=True, help="Print names, files and texts as JSON on stdout.")
def configs(as_json: bool) -> None:
    """List the configurations that come with tel.

    Their names can be given wherever a command takes CONFIG: `tel practice paper`. To change more than a few
    keys (--set), copy a file from the folder that this prints, together with the arm that it names.
    """
    files, folder = shipped_configs(), config_folder()
    rows = [{"name": name, "file": str(file), "about": summary_of(file)} for name, file in files.items()]
    if as_json:
        click.echo(json.dumps(rows, indent=2))
        return
    shown = ("name", "about")
    show(table(shown, [[row[key] for key in shown] for row in rows], left=shown), f"folder  {folder}")
