"""``tel view``, and ``--view`` of ``tel practice``; viser and ROS are imported when they are needed."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import click
from rich.console import Console

from tel_ros.app.bring_up import die_with_parent, end_process
from tel_ros.app.config_argument import config_argument, namespace_option, overrides_option
from tel_ros.app.errors import Interruption
from tel_ros.app.view import ViewError
from tel_ros.recording.config_file import load_config

if TYPE_CHECKING:
    from tel_ros.app.practice import Beside

view_option = click.option(
    "--view/--no-view", "with_view", default=False, help="Show the run in the browser; prints a link."
)


def _require_view() -> None:
    missing = [name for name in ("viser", "yourdfpy") if find_spec(name) is None]
    if missing:
        raise ViewError(f"the live view needs {', '.join(missing)}: pip install 'tel_ros[view]'")


def beside_run(with_view: bool, console: Console, namespace: str = "/") -> Beside:
    """Return what runs beside a practice run: the live view (ViewError without its extra), or nothing."""
    if not with_view:
        return lambda config_file, log_folder: nullcontext()
    _require_view()
    return partial(_view_process, console, namespace)


@contextmanager
def _view_process(console: Console, namespace: str, config_file: Path, log_folder: Path) -> Iterator[None]:
    """Run the view as a process beside a practice run, which neither waits for it nor needs it.

    What it says, its link or why there is none, comes to the console from another thread.
    """
    log_folder.mkdir(parents=True, exist_ok=True)
    with (log_folder / "view.log").open("wb") as log:
        process = subprocess.Popen(
            [sys.executable, "-m", "tel_ros.app.view.main", str(config_file), namespace],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=log,
            text=True,
            start_new_session=True,  # Ctrl-C reaches the supervisor only
            preexec_fn=partial(die_with_parent, os.getpid()),
        )

    def listen() -> None:
        for line in process.stdout or ():
            console.print(line.rstrip(), highlight=False, soft_wrap=True, markup=False)

    threading.Thread(target=listen, daemon=True).start()
    try:
        yield
    finally:
        end_process(process, signal.SIGTERM, 3.0)


@click.command()
@config_argument
@overrides_option("Another value for a key, as in practice.")
@namespace_option
@click.option("--port", type=click.IntRange(0, 65535), default=0, help="Of the page. Default: any free one.")
def view(config_file: Path, overrides: tuple[str, ...], namespace: str, port: int) -> None:
    """Show a running graph in the browser: a simulated or a real arm.

    CONFIG is the configuration of the run, or run.yaml in its folder. The page is at the link that is
    printed, on this computer only. Ctrl-C ends the view; the graph keeps running.
    """
    _require_view()
    Interruption.watch()
    from tel_ros.nodes.robot_description import description_in  # isort: skip - first: whether ROS can start
    from tel_ros.app.view.main import watch

    watch(load_config(config_file, overrides, partial(description_in, namespace)), namespace, port)
