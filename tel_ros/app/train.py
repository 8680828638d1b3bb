"""``tel train``: a network from the bags of practice runs, or with ``--import`` from other recordings."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click
from click.core import ParameterSource

from tel_ros.app.config_argument import F, overrides_option
from tel_ros.app.errors import EXIT_INTERRUPTED, end
from tel_ros.app.tables import show, table, trial_table
from tel_ros.core.errors import counted


def _import_option(name: str, about: str, **settings: Any) -> Callable[[F], F]:
    shown = bool(settings.get("default"))
    return click.option(name, help=f"With --import: {about}", show_default=shown, **settings)


@click.command()
@click.argument("bags", metavar="BAG…", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option(
    "--out",
    required=True,
    type=click.Path(path_type=Path, dir_okay=False),
    help="File of the network, e.g. network.npz.",
)
@click.option("--force", is_flag=True, help="Replace the file if there is one already. Not with --import.")
@overrides_option(
    "Another setting of the learner, e.g. learning.weights=least_squares, or seed. Not with --import."
)
@click.option(
    "--json", "as_json", is_flag=True, help="Print what came out as JSON, and nothing else, on stdout."
)
@click.option("--import", "imports", is_flag=True, help="BAGs are recordings that other programs made.")
@_import_option(
    "--learner",
    "rigid_body, polynomial, lms_tree, rigid_body+lms_tree, or an installed one.",
    default="rigid_body",
)
@_import_option("--urdf", "URDF of the arm (or package://…); for rigid_body.", default="")
@_import_option("--topic", "topic of the bags. Default: the one with most of the joints.", default="")
@_import_option("--joints", "joints to learn, a,b,c. Default: all in the URDF that have efforts.", default="")
@_import_option(
    "--rename",
    "FROM=TO: joints whose names begin with FROM are TO… in the URDF. May be given several times.",
    metavar="FROM=TO",
    multiple=True,
)
@_import_option("--rate-hz", "rate of the samples that are learned from, at most.", type=float, default=200.0)
@_import_option("--cutoff-hz", "zero-phase low-pass, 0 for none. Default: chosen from the data.", type=float)
@_import_option(
    "--weights",
    "how trees find their weights.",
    type=click.Choice(["least_squares", "lms"]),
    default="least_squares",
)
@_import_option(
    "--max-subtrees",
    "that grow for each joint; with many joints each of them costs much time.",
    type=click.IntRange(min=0),
    default=2,
)
@click.pass_context
def train(
    context: click.Context,
    /,
    bags: tuple[Path, ...],
    out: Path,
    force: bool,
    overrides: tuple[str, ...],
    as_json: bool,
    imports: bool,
    **import_settings: Any,
) -> None:
    """Rebuild the network from BAGs alone, in the order given.

    A BAG is a trial's folder; the folder of a run stands for all its trials. Everything else that it takes
    is in the bags. With the recorded settings the network becomes, bit for bit, the one that the run has
    left. Bags of different arms are refused, and so are unfinished, recovered and damaged ones. Nothing of
    ROS runs.

    With --import a BAG is any recording with efforts: a bag of ROS 1 or ROS 2 (sqlite3, MCAP; with or without
    metadata.yaml) with sensor_msgs/JointState or trajectory_msgs/JointTrajectory, or a CSV with the columns
    time_s, q_<joint>, tau_<joint>. Torques are learned, and how good they are is told from parts of the
    recording that were held back.
    """
    if imports:
        wrong = {"--set": overrides, "--force": force}
        if given := [name for name, value in wrong.items() if value]:
            raise click.UsageError(f"{' and '.join(given)} cannot be used with --import")
        _run_import(bags, out, as_json, **import_settings)
        return
    source = context.get_parameter_source
    of_import = [option for option in context.command.params if option.name in import_settings]
    given = [each.opts[0] for each in of_import if source(each.name) is not ParameterSource.DEFAULT]
    if given:
        raise click.UsageError(f"{' and '.join(given)} can only be used with --import")
    from tel_ros.recording.retraining import train as train_on  # late: `tel --help` needs no learners

    def learned(bag: Path) -> None:
        click.echo(f"learned  {bag}", err=True)

    try:
        made = train_on(bags, out, overrides, force=force, on_lesson=learned)
    except KeyboardInterrupt:
        end("interrupted: no network was written", EXIT_INTERRUPTED)
    if as_json:
        click.echo(json.dumps(made, indent=2))
        return
    comparison = "some bags do not tell which network commanded them"
    if made["as_recorded"]:
        comparison = "each trial had been commanded by the network that there was here before it"
    elif made["differs_at"]:
        comparison = f"not that of the run, {made['differs_at']} had been commanded by another one"
    lines = [row["note"] and f"note     trial {row['index']}: {row['note']}" for row in made["bags"]]
    lines += [f"network  {made['network']}", f"revision {made['revision']}: {comparison}"]
    show(trial_table(made["bags"], without=("α", "max error\nrad")), *filter(None, lines))


def _run_import(bags: tuple[Path, ...], out: Path, as_json: bool, *, joints: str, **settings: Any) -> None:
    # Imported late: it takes half a second.
    from tel_ros.app.torque_import import import_and_train

    names = tuple(name.strip() for name in joints.split(",") if name.strip())
    _, report = import_and_train(bags, out, joints=names, **settings)
    for warning in report["warnings"]:
        click.echo(f"tel: warning: {warning}", err=True)
    if as_json:
        click.echo(json.dumps(report, indent=2, allow_nan=False))
    else:
        _show_import(report)


def _show_import(report: dict[str, Any]) -> None:
    numbers = {
        "nMSE": ("nmse", ".4f"),
        "RMS error N·m": ("rms_nm", ".3g"),
        "expected": ("expected_rms_nm", ".3g"),
        "torque N·m": ("torque_std_nm", ".3g"),
        "rad/s": ("velocity_rad_s", ".2f"),
        "rad/s²": ("acceleration_rad_s2", ".2f"),
        "cond.": ("condition", ".2g"),
    }
    rows = [
        (
            joint["joint"],
            "{:.2f} … {:.2f}".format(*joint["position_rad"]),
            *("–" if joint[key] is None else format(joint[key], how) for key, how in numbers.values()),
        )
        for joint in report["joints"]
    ]
    band = " to ".join(dict.fromkeys(f"{cutoff:.3g}" for cutoff in report["cutoff_hz"]))
    held_out = report["held_out"]
    show(
        table(("joint", "from … to rad", *numbers), rows, left=("joint",)),
        *(
            f"recorded  {r['source']}: {counted(r['n_samples'], 'sample')} in {r['duration_s']:.4g} s, "
            f"{r['rate_hz']:.4g} Hz, jitter {1e3 * r['jitter_s']:.2g} ms"
            for r in report["recordings"]
        ),
        f"learned   {report['learned_s']:.4g} s in {counted(report['unbroken_parts'], 'unbroken part')}, "
        f"up to {band} Hz, by {report['learner']}",
        f"held out  mean nMSE {held_out['mean_nmse']:.4f}: {held_out['blocks']} blocks of "
        f"{held_out['block_s']:.3g} s, every fifth not learned from in turn",
        f"network   {report['network']} (predicts torque; revision {report['revision']})",
    )
