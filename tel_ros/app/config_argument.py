"""The argument CONFIG of the commands: a file, or the name of a configuration that comes with the package."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click
from click.shell_completion import CompletionItem

from tel_ros.app.errors import EXIT_BAD_INPUT, end
from tel_ros.core.errors import TelError
from tel_ros.recording.shared_files import shipped_configs


class ConfigFile(click.ParamType):
    """A YAML file. Where there is none, a bare name is looked for among the shipped configurations.

    A file of the user's always comes first: what lies in the working folder is what is meant.
    """

    name = "config"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """Return the file; one that does not exist is left to the reader, which says so."""
        path = Path(value)
        if path.is_file() or path.name != str(value):
            return path
        try:
            shipped = shipped_configs()
        except TelError as error:
            end(str(error), EXIT_BAD_INPUT)
        if str(value) in shipped:
            return shipped[str(value)]
        names = ", ".join(shipped)
        end(f"{value}: there is no such file; expected a YAML file, or one of {names}", EXIT_BAD_INPUT)

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
