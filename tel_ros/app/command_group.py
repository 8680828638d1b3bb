"""Groups of commands: imported when they are needed, from other packages too, with one way out for errors."""

from __future__ import annotations

import io
import sys
import traceback
import warnings
from collections.abc import Callable, Mapping
from importlib import import_module
from importlib.util import find_spec
from operator import attrgetter
from types import MappingProxyType
from typing import Any, NoReturn

import click

from tel_ros.app.errors import (
    EXIT_BAD_INPUT,
    EXIT_GRAPH_FAILED,
    EXIT_INTERRUPTED,
    GraphError,
    Interruption,
    end,
    wants_traceback,
)
from tel_ros.core.errors import TelError

_LABORATORY = "tel_lab"
"""A package of the same distribution. Its ``ENTRY_POINTS`` (group → name → "module:attribute") is what
setup.py installs; it is also read here, because a checkout keeps the entry points it was installed with."""

_COMES_WITH = {
    "jinja2": "pip install 'tel_ros[report]'",
    "matplotlib": "pip install 'tel_ros[report]'",
    "pinocchio": "pip install 'tel_ros[rigid-body]'",
    "pybullet": "pip install 'tel_ros[sim]'",
    "sklearn": "pip install 'tel_ros[lab]'",
    "toppra": "pip install 'tel_ros[compare]'",
    "rclpy": "ROS 2 Jazzy: a sourced installation, or pip install 'tel_ros[ros]'",
    "tel_interfaces": "the wheel of that name beside that of tel_ros (`make dist`), or colcon",
}
"""Python module to what installs it, for the parts of tel that not everybody needs."""


def extensions(group: str) -> dict[str, str]:
    """Return the name and the place ("module:attribute") of everything that packages offer in a group."""
    from importlib import metadata  # late: `tel stop` has no time for what is not its own

    places = {point.name: point.value for point in metadata.entry_points(group=group)}
    if find_spec(_LABORATORY) is None:
        # Installed once, but not there: a checkout without it.
        return {name: place for name, place in places.items() if not place.startswith(f"{_LABORATORY}.")}
    return places | getattr(import_module(_LABORATORY), "ENTRY_POINTS", {}).get(group, {})


def load(place: str) -> Any:
    """Return what is at a place ("module:attribute")."""
    module, _, name = place.partition(":")
    return attrgetter(name)(import_module(module))


class LazyGroup(click.Group):
    """A group that imports a command when it is asked for; ``own`` and ``places`` say where it is."""

    def __init__(
        self,
        *args: Any,
        own: Mapping[str, str] = MappingProxyType({}),
        places: Callable[[], Mapping[str, str]] = dict[str, str],
        **kwargs: Any,
    ) -> None:
        super().__init__(*args, **kwargs)
        self._own, self._places = own, places

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names of all commands."""
        return sorted({*super().list_commands(ctx), *self._own, *self._places()})

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Return a command; one that cannot be imported ends with the reason when it is run."""
        place = self._own.get(cmd_name) or self._places().get(cmd_name)
        if place is None:
            return super().get_command(ctx, cmd_name)
        try:
            command: click.Command = load(place)
        except Exception as error:  # whatever a foreign package raises; the other commands work all the same
            return _unusable(cmd_name, place, error)
        return command


def _unusable(name: str, place: str, error: Exception) -> click.Command:
    def fail() -> NoReturn:
        raise error

    settings = {"ignore_unknown_options": True, "allow_extra_args": True}
    return click.Command(
        name, callback=fail, help=f"Cannot be loaded from {place}: {error}", context_settings=settings
    )


class CommandGroup(LazyGroup):
    """Ends in one line, without a traceback unless TEL_DEBUG is set, whatever a command raises."""

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command that was asked for."""
        for stream in (sys.stdout, sys.stderr):
            if isinstance(stream, io.TextIOWrapper):
                stream.reconfigure(errors="replace")  # not every terminal has an α
        try:
            with warnings.catch_warnings():
                # As a person reads it: without the line of code that gave it.
                warnings.showwarning = lambda said, *_, **__: click.echo(f"warning: {said}", err=True)
                return super().invoke(ctx)
        except (click.ClickException, click.exceptions.Exit, click.Abort):
            raise
        except Interruption.errors():
            end("interrupted", EXIT_INTERRUPTED)
        except GraphError as error:
            end(str(error), error.exit_code)
        except TelError as error:
            end(str(error), EXIT_BAD_INPUT)
        except ModuleNotFoundError as error:
            if _source(error) is None:
                _end_unexpected(error)
            end(f"this {missing_module(error)}", EXIT_GRAPH_FAILED)
        except Exception as error:
            _end_unexpected(error)


def missing_module(error: ModuleNotFoundError) -> str:
    """Return which module is missing, and what it comes with if it is one of ours."""
    source = _source(error)
    return f"needs the Python module {error.name}" + (f", which comes with {source}" if source else "")


def _source(error: ModuleNotFoundError) -> str | None:
    return _COMES_WITH.get((error.name or "").split(".")[0])


def _end_unexpected(error: Exception) -> NoReturn:
    frame = traceback.extract_tb(error.__traceback__)[-1]
    hint = "" if wants_traceback() else "; TEL_DEBUG=1 shows the traceback"
    where = f"{frame.filename}:{frame.lineno}"
    said = " ".join(str(error).split())
    end(f"unexpected {type(error).__name__}: {said} ({where}){hint}", EXIT_GRAPH_FAILED)
