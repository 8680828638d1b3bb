"""The argument CONFIG of the commands: a file, or the name of a configuration that comes with the package."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click
from click.shell_completion import CompletionItem

from tel_ros.app.errors import EXIT_BAD_INPUT, end
from tel_ros.core.errors import TelError
from tel_ros.recording.shared_files import named_config, shipped_configs


class ConfigFile(click.ParamType):
    """A YAML file, or the name of a shipped configuration."""

    name = "config"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """Return the file; one that does not exist is left to the reader, which says so."""
        try:
            return named_config(str(value))
        except TelError as error:
            end(str(error), EXIT_BAD_INPUT)

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
