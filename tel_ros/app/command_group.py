"""The group of commands below ``tel``: what no command has caught ends in one line, too."""

from __future__ import annotations

import traceback
from typing import Any, NoReturn

import click

from tel_ros.app.errors import EXIT_BAD_INPUT, EXIT_GRAPH_FAILED, EXIT_INTERRUPTED, end, wants_traceback
from tel_ros.core.errors import TelError

_COMES_WITH = {
    "jinja2": "pip install 'tel_ros[report]'",
    "matplotlib": "pip install 'tel_ros[report]'",
    "pinocchio": "pip install 'tel_ros[rigid-body]'",
    "pybullet": "pip install 'tel_ros[sim]'",
    "rclpy": "ROS 2 Jazzy: a sourced installation, or pip install 'tel_ros[ros]'",
    "tel_interfaces": "the wheel of that name beside that of tel_ros (`make dist`), or colcon",
}
"""What the parts of tel that not everybody needs come from, by the Python module."""


class CommandGroup(click.Group):
    """Commands whose unexpected errors are told without a traceback, unless TEL_DEBUG is set."""

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command that was asked for."""
        try:
            return super().invoke(ctx)
        except (click.ClickException, click.exceptions.Exit, click.Abort):
            raise
        except KeyboardInterrupt:
            end("interrupted", EXIT_INTERRUPTED)
        except TelError as error:
            end(str(error), EXIT_BAD_INPUT)
        except ModuleNotFoundError as error:
            source = _COMES_WITH.get((error.name or "").split(".")[0])
            if source is None:
                _end_unexpected(error)
            end(f"this needs the Python module {error.name}, which comes with {source}", EXIT_GRAPH_FAILED)
        except Exception as error:
            _end_unexpected(error)


def _end_unexpected(error: Exception) -> NoReturn:
    frame = traceback.extract_tb(error.__traceback__)[-1]
    hint = "" if wants_traceback() else "; TEL_DEBUG=1 shows how it came to that"
    where = f"{frame.filename}:{frame.lineno}"
    said = " ".join(str(error).split())
    end(f"unexpected {type(error).__name__}: {said} ({where}){hint}", EXIT_GRAPH_FAILED)
