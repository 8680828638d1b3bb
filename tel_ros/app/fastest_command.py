"""``tel fastest``."""

from __future__ import annotations

import json
from pathlib import Path

import click

from tel_ros.app.config_argument import ConfigFile, overrides_option
from tel_ros.app.tables import fixed, show, table
from tel_ros.core.errors import ConfigError, InputFileError


@click.command()
@click.argument("source", metavar="CONFIG|RUN")
@click.option(
    "--joint-limits", type=click.Path(path_type=Path), help="joint_limits.yaml to write; must not exist."
)
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON on stdout, and nothing else.")
@click.option("--path", default="", help="Which of several paths (path.files): its name.")
@overrides_option("Another value for a key, e.g. practice.effort_share=0.8.")
def fastest(
    source: str, joint_limits: Path | None, as_json: bool, path: str, overrides: tuple[str, ...]
) -> None:
    """Tell how fast an arm could run its path, without moving it.

    Of a CONFIG it is what the masses, inertias and frictions of the URDF would allow; they are seldom right.
    Of the folder of a RUN it is what was learned there. Efforts stay within practice.effort_share of their
    limits, and grow no faster than the safety layer lets them.

    --joint-limits writes limits of velocity and acceleration for MoveIt: within them, whatever the joints do
    at the same time in the postures of the path, efforts stay within that share.
    """
    from tel_ros.app.fastest import by_run, by_urdf, limited_by  # late: learners take seconds to load
    from tel_ros.recording.run_folder import is_run_folder, json_ready, write_atomically

    if joint_limits is not None and joint_limits.exists():
        raise InputFileError(joint_limits, "exists already", "a name that is free")
    if not is_run_folder(Path(source)):
        found = by_urdf(ConfigFile().convert(source, None, None), overrides, path)
    elif overrides:
        raise ConfigError("--set", overrides[0], "a CONFIG: a RUN has its own values")
    else:
        found = by_run(Path(source), path)
    practice, path = found.config.practice, found.config.path.name or found.config.path.file
    times = [
        {
            "effort_share": share,
            "time_optimal_s": found.fastest(share).duration_s,
            "minimum_jerk_s": found.fastest(share, "minimum_jerk").duration_s,
        }
        for share in found.shares
    ]
    joints = limited_by(found.config, found.movement.effort_nm, found.movement.velocity_rad_s)
    if joint_limits is not None:
        try:
            write_atomically(joint_limits, found.moveit())
        except OSError as error:
            expected = "a file that can be written"
            raise InputFileError(joint_limits, f"cannot be written ({error.strerror})", expected) from error
    if as_json:
        keys = ("joint", "effort", "at_its_effort", "velocity", "at_its_velocity")
        rows = [dict(zip(keys, row, strict=True)) for row in joints]
        result = {"known_from": found.known_from, "path": path, "times": times, "joints": rows}
        click.echo(json.dumps(json_ready(result), allow_nan=False))
        return
    show(
        f"{path} with {found.config.arm.name}, by {found.known_from}; nothing has moved",
        table(
            ("effort\n% of limits", "time-optimal\ns", "minimum jerk\ns"),
            [
                (
                    f"{100 * row['effort_share']:g}",
                    fixed(row["time_optimal_s"], 3),
                    fixed(row["minimum_jerk_s"], 3),
                )
                for row in times
            ],
        ),
        f"What limits the time-optimal movement with {100 * practice.effort_share:g} % of the efforts:",
        table(
            (
                "joint",
                "effort\n% of limit",
                "as much as it may\n% of time",
                "velocity\n% of limit",
                "as fast as it may\n% of time",
            ),
            [(joint, *(f"{100 * share:.0f}" for share in shares)) for joint, *shares in joints],
            left=("joint",),
        ),
    )
    if joint_limits is not None:
        show(f"written to {joint_limits}")
