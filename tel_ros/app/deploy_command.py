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
@click.option("--path", "name", help="Which of several (path.files): its name. Default: all, a folder each.")
@click.option(
    "--rate-hz",
    type=float,
    default=1000.0,
    show_default=True,
    help="update_rate of the controller manager.",
)
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON on stdout, and nothing else.")
def deploy(run: Path, out: Path, trial: int | None, name: str | None, rate_hz: float, as_json: bool) -> None:
    """Write a practised movement for ros2_control's joint_trajectory_controller.

    The folder needs no tel_ros: the trajectory with efforts (YAML, and a bag), the controller's gains, a
    client, and a README with the command that runs it and the error to expect. What was not practised within
    practice.tolerance_rad is refused.

    Of a run with several paths each movement gets a folder of its own, FOLDER/PATH. With --path or --trial it
    is one, in FOLDER.
    """
    from tel_ros.recording.export.deployment import deploy_all, practised  # late: bags take long to import
    from tel_ros.recording.run_folder import is_run_folder, json_ready, written_config

    if not 1.0 <= rate_hz <= 1e5:
        raise ConfigError("--rate-hz", rate_hz, "1 to 100,000")
    names: tuple[str, ...] = ()
    if is_run_folder(run):
        several = written_config(run).path
        names = several.names
        if name is not None:
            several.one(name)
    if name is not None or trial is not None or not names:
        movements = {out: practised(run, rate_hz, trial, name or "")}
    else:
        movements = {out / each: practised(run, rate_hz, path=each) for each in names}
    deploy_all(movements, out)
    if as_json:
        results = [
            {"folder": str(folder), "points": len(each.points.time_ns), "trial": each.report.to_plain()}
            for folder, each in movements.items()
        ]
        result = results[0] if out in movements else {"folder": str(out), "movements": results}
        click.echo(json.dumps(json_ready(result), allow_nan=False))
        return
    for folder, each in movements.items():
        report = each.report
        show(
            f"trial {report.index}: {report.duration_s:.3f} s with {1e3 * report.rms_error_rad:.2f} mrad RMS "
            f"in {len(each.points.time_ns)} points",
            f"written to {folder}; {folder / 'README.md'} says how to run it",
        )
