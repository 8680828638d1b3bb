"""``tel deploy``."""

from __future__ import annotations

import json
from pathlib import Path

import click

from tel_ros.app.tables import show
from tel_ros.core.errors import ConfigError


@click.command()
@click.argument("run", metavar="RUN", type=click.Path(path_type=Path))
@click.option(
    "--out", type=click.Path(path_type=Path), required=True, help="Folder to write; must not exist."
)
@click.option("--trial", type=click.IntRange(min=1), help="Which. Default: the fastest within the tolerance.")
@click.option(
    "--rate-hz",
    type=float,
    default=1000.0,
    show_default=True,
    help="update_rate of the controller manager.",
)
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON on stdout, and nothing else.")
def deploy(run: Path, out: Path, trial: int | None, rate_hz: float, as_json: bool) -> None:
    """Write a practised movement for ros2_control's joint_trajectory_controller.

    The folder needs no tel_ros: the trajectory with efforts (YAML, and a bag), the controller's gains, a
    client, and a README with the command that runs it and the error to expect. What was not practised within
    practice.tolerance_rad is refused.
    """
    from tel_ros.recording.export.deployment import deploy as write  # late: bags take long to import
    from tel_ros.recording.export.deployment import practised
    from tel_ros.recording.run_folder import json_ready

    if not 1.0 <= rate_hz <= 1e5:
        raise ConfigError("--rate-hz", rate_hz, "1 to 100,000")
    movement = practised(run, rate_hz, trial)
    write(movement, out)
    report = movement.report
    if as_json:
        result = {"folder": str(out), "points": len(movement.time_ns), "trial": report.to_plain()}
        click.echo(json.dumps(json_ready(result), allow_nan=False))
        return
    show(
        f"trial {report.index}: {report.duration_s:.3f} s with {1e3 * report.rms_error_rad:.2f} mrad RMS, "
        f"in {len(movement.time_ns)} points",
        f"written to {out}; {out / 'README.md'} says how to run it",
    )
