"""What `tel practice --resume` takes and says."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import click

from tel_ros.app.errors import EXIT_BAD_INPUT, end

if TYPE_CHECKING:
    from tel_ros.recording.resumption import Resumption


def require_either(config_file: Path | None, resumed: Path | None, others: Mapping[str, object]) -> None:
    """End with a message unless a new run is asked for, or one that is to go on as it was begun.

    Args:
        config_file: of a new run.
        resumed: folder of a run that is to go on.
        others: options that only a new run can have.
    """
    if resumed is None:
        if config_file is None:
            end("nothing to practise: expected CONFIG, or --resume RUN", EXIT_BAD_INPUT)
        return
    given = [name for name, value in others.items() if value]
    given += [] if config_file is None else [f"CONFIG ({config_file})"]
    if given:
        expected = f"--resume {resumed} alone: a run goes on as its run.yaml says, into its own folder"
        end(f"{', '.join(given)} given with --resume; expected {expected}", EXIT_BAD_INPUT)


def say_what_goes_on(folder: Path, resumption: Resumption) -> None:
    """Say on stderr what a run goes on from, and where what it does not go on from was put."""
    for path, why in resumption.set_aside.items():
        click.echo(f"set aside  {path} ({why})", err=True)
    click.echo(f"resumed    {folder} after {resumption.trials} whole trials", err=True)
