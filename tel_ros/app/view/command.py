"""The command ``tel view``, and the option ``--view`` of ``tel practice``. Neither viser nor ROS at once."""

from __future__ import annotations

import secrets
import signal
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import click
from rich.console import Console

from tel_ros.app.config_argument import config_argument, namespace_option
from tel_ros.app.errors import EXIT_BAD_INPUT, end
from tel_ros.app.view.gate import ViewError
from tel_ros.core.errors import TelError
from tel_ros.recording.config_file import load_config

if TYPE_CHECKING:
    from tel_ros.app.practice import Beside

_NEEDED = ("viser", "yourdfpy")
_TOKEN_BYTES = 24

view_option = click.option(
    "--view/--no-view", "with_view", default=False, help="Show the run in the browser; prints a link."
)


def require_view() -> None:
    """Make sure that the extra ``view`` is installed.

    Raises:
        ViewError: it is not; the message says how to install it.
    """
    missing = [name for name in _NEEDED if find_spec(name) is None]
    if missing:
        raise ViewError(f"the live view needs {', '.join(missing)}: pip install 'tel_ros[view]'")


def new_token() -> str:
    """Return a secret that nobody can guess."""
    return secrets.token_urlsafe(_TOKEN_BYTES)


def beside_run(with_view: bool, console: Console, namespace: str = "/") -> Beside:
    """Return what goes on beside a practice run: the live view, or nothing.

    Raises:
        ViewError: the extra ``view`` is not installed.
    """
    from tel_ros.app.practice import nothing_beside  # late: the command line needs no ROS to give its help

    if not with_view:
        return nothing_beside
    require_view()
    from tel_ros.app.view.companion import ViewProcess

    def tell(line: str) -> None:
        console.print(f"view    {line}", highlight=False, soft_wrap=True, markup=False)

    return lambda config_file, log_folder: ViewProcess(config_file, log_folder, new_token(), tell, namespace)


@click.command()
@config_argument
@click.option(
    "--set", "overrides", metavar="KEY=VALUE", multiple=True, help="Another value for a key, as in practice."
)
@namespace_option
@click.option("--port", type=click.IntRange(0, 65535), default=0, help="Of the page. Default: any free one.")
def view(config_file: Path, overrides: tuple[str, ...], namespace: str, port: int) -> None:
    """Show a graph that is running, in the browser: a simulated or a real arm.

    CONFIG is the configuration of the run, or run.yaml in its folder. The page is at the link that is
    printed, on this computer alone. Ctrl-C ends the view; the graph goes on.
    """
    stopping: list[int] = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda number, frame: stopping.append(number))
    try:
        require_view()
        from tel_ros.app.view.main import be_modest, watch

        be_modest()
        out = Console(file=sys.stdout)  # kept: what viser prints goes elsewhere
        watch(
            load_config(config_file, overrides),
            new_token(),
            port,
            lambda link: out.print(f"view    {link}", highlight=False, soft_wrap=True, markup=False),
            lambda: bool(stopping),
            namespace,
        )
    except TelError as error:
        end(str(error), EXIT_BAD_INPUT)
