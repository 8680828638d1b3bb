"""What several commands take: CONFIG, a file or the name of a shipped configuration, and ``--namespace``."""

from __future__ import annotations

import re
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


class Namespace(click.ParamType):
    """A ROS namespace, with or without a slash at its beginning; it gets one."""

    name = "namespace"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        """Return the full namespace."""
        full = "/" + str(value).strip("/")
        if full != "/" and not re.fullmatch(r"(/[A-Za-z][A-Za-z0-9_]*)+", full):
            self.fail(f"{value!r} is no namespace; expected letters, digits and _, as in left or lab/left")
        return full


namespace_option = click.option(
    "--namespace",
    type=Namespace(),
    default="/",
    help="ROS namespace of the arm and of all nodes, e.g. left: two arms can practise side by side.",
)
