"""``tel train --import``: learning torques from other programs' recordings."""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import reduce
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click
from click.core import ParameterSource

from tel_ros.app.tables import show, simple_table

if TYPE_CHECKING:
    from tel_ros.app.torque_import import ImportReport

F = TypeVar("F", bound=Callable[..., Any])


def _option(name: str, text: str, **settings: Any) -> Callable[[F], F]:
    return click.option(name, help=f"With --import: {text}", **settings)


_OPTIONS = (
    _option(
        "--learner",
        "rigid_body, lms_tree, rigid_body+lms_tree, or an installed one.",
        default="rigid_body",
        show_default=True,
    ),
    _option("--urdf", "URDF of the arm (or package://…); for rigid_body.", default=""),
    _option("--topic", "topic of the bags. Default: the one that has efforts.", default=""),
    _option("--joints", "joints to learn, a,b,c. Default: all that have efforts.", default=""),
    _option(
        "--rate-hz",
        "rate of the samples that are learned from, at most.",
        type=float,
        default=200.0,
        show_default=True,
    ),
    _option("--cutoff-hz", "zero-phase low-pass, 0 for none. Default: chosen from the data.", type=float),
    _option(
        "--weights",
        "how trees find their weights.",
        type=click.Choice(["least_squares", "lms"]),
        default="least_squares",
        show_default=True,
    ),
    _option(
        "--max-subtrees",
        "that grow for each joint; with many joints each of them costs much time.",
        type=click.IntRange(min=0),
        default=2,
        show_default=True,
    ),
)
_NAMES = ("learner", "urdf", "topic", "joints", "rate_hz", "cutoff_hz", "weights", "max_subtrees")


def import_options(function: F) -> F:
    """Add the options of an import to a command."""
    return reduce(lambda command, option: option(command), reversed(_OPTIONS), function)


def given_options(context: click.Context) -> list[str]:
    """Return those options of an import that stand on the command line."""
    return [
        option.opts[0]
        for option in context.command.params
        if option.name in _NAMES and context.get_parameter_source(option.name) is not ParameterSource.DEFAULT
    ]


def run_import(sources: tuple[Path, ...], out: Path, as_json: bool, *, joints: str, **settings: Any) -> None:
    """Learn torque from recordings, and print how good it is."""
    # Imported late: it takes half a second.
    from tel_ros.app.torque_import import ImportRequest, import_and_train

    names = tuple(name.strip() for name in joints.split(",") if name.strip())
    report = import_and_train(ImportRequest(sources=sources, out=out, joints=names, **settings))
    for warning in report.warnings:
        click.echo(f"tel: warning: {warning}", err=True)
    if as_json:
        click.echo(json.dumps(report.as_plain(), indent=2, allow_nan=False))
    else:
        _show(report)


def _show(report: ImportReport) -> None:
    numbers = ("nMSE", "RMS error N·m", "expected", "torque N·m", "from … to rad", "rad/s", "rad/s²", "cond.")
    table = simple_table("joint", *numbers, left=("joint",))
    held_out = report.fit.held_out
    for j, excited in enumerate(report.excitation.joints):
        table.add_row(
            excited.joint,
            f"{held_out.nmse[j]:.4f}",
            f"{held_out.rms_nm[j]:.3g}",
            f"{held_out.expected_rms_nm[j]:.3g}",
            f"{report.torque_std_nm[j]:.3g}",
            f"{excited.position_rad[0]:.2f} … {excited.position_rad[1]:.2f}",
            f"{excited.velocity_rad_s:.2f}",
            f"{excited.acceleration_rad_s2:.2f}",
            f"{excited.condition:.2g}",
        )
    show(table)
    low, high = report.cutoff_hz
    band = f"{low:.3g} Hz" if low == high else f"{low:.3g} to {high:.3g} Hz"
    for r in report.recordings:
        click.echo(
            f"recorded  {r['source']}: {r['n_samples']} samples in {r['duration_s']:.4g} s, "
            f"{r['rate_hz']:.4g} Hz, jitter {1e3 * r['jitter_s']:.2g} ms"
        )
    click.echo(
        f"learned   {report.learned_s:.4g} s in {report.n_parts} unbroken parts, up to {band}, "
        f"by {report.learner}"
    )
    click.echo(
        f"held out  mean nMSE {held_out.nmse.mean():.4f}: {report.fit.n_blocks} blocks of "
        f"{report.fit.block_s:.3g} s, every fifth not learned from in turn"
    )
    click.echo(f"network   {report.network} (predicts torque; revision {report.revision})")
