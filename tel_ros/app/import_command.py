"""Command line of learning from other people's recordings."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click
from click.core import ParameterSource
from rich import box
from rich.console import Console
from rich.table import Table

from tel_ros.app.errors import EXIT_BAD_INPUT, end
from tel_ros.core.errors import TelError

if TYPE_CHECKING:
    from tel_ros.app.imported import ImportReport

F = TypeVar("F", bound=Callable[..., Any])
_OUT = Console()
_LOG_WIDTH = 140
_OPTIONS = ("learner", "urdf", "topic", "joints", "rate_hz", "cutoff_hz", "weights", "max_subtrees")


def import_options(function: F) -> F:
    """Add to a command the options that :func:`run_import` takes, but for the sources, --out and --json."""
    options = (
        click.option(
            "--learner",
            default="rigid_body",
            show_default=True,
            help="With --import: rigid_body, lms_tree, rigid_body+lms_tree, or an installed one.",
        ),
        click.option(
            "--urdf", default="", help="With --import: URDF of the arm (or package://…); for rigid_body."
        ),
        click.option(
            "--topic", default="", help="With --import: topic of the bags. Default: the one that has efforts."
        ),
        click.option(
            "--joints",
            default="",
            help="With --import: joints to learn, a,b,c. Default: all that have efforts.",
        ),
        click.option(
            "--rate-hz",
            type=float,
            default=200.0,
            show_default=True,
            help="With --import: rate of the samples that are learned from, at most.",
        ),
        click.option(
            "--cutoff-hz",
            type=float,
            help="With --import: zero-phase low-pass, 0 for none. Default: chosen from the data.",
        ),
        click.option(
            "--weights",
            type=click.Choice(["least_squares", "lms"]),
            default="least_squares",
            show_default=True,
            help="With --import: how trees find their weights.",
        ),
        click.option(
            "--max-subtrees",
            type=click.IntRange(min=0),
            default=2,
            show_default=True,
            help="With --import: that grow for each joint; with many joints each of them costs much time.",
        ),
    )
    for option in reversed(options):
        function = option(function)
    return function


def given_options(context: click.Context) -> list[str]:
    """Return those of :func:`import_options` that stand on the command line."""
    return [
        option.opts[0]
        for option in context.command.params
        if option.name in _OPTIONS
        and context.get_parameter_source(option.name) is not ParameterSource.DEFAULT
    ]


def run_import(
    sources: tuple[Path, ...],
    out: Path,
    as_json: bool,
    *,
    learner: str,
    urdf: str,
    topic: str,
    joints: str,
    rate_hz: float,
    cutoff_hz: float | None,
    weights: Any,
    max_subtrees: int,
) -> None:
    """Learn torque from recordings and say how good it is; end with exit code 2 if it cannot be done."""
    # Late: it takes half a second to import.
    from tel_ros.app.imported import ImportRequest, import_and_train

    try:
        request = ImportRequest(
            sources=sources,
            out=out,
            learner=learner,
            urdf=urdf,
            topic=topic,
            joints=tuple(name.strip() for name in joints.split(",") if name.strip()),
            rate_hz=rate_hz,
            cutoff_hz=cutoff_hz,
            weights=weights,
            max_subtrees=max_subtrees,
        )
        report = import_and_train(request)
    except TelError as error:
        end(str(error), EXIT_BAD_INPUT)
    for warning in report.warnings:
        click.echo(f"tel: warning: {warning}", err=True)
    if as_json:
        click.echo(json.dumps(report.as_plain(), indent=2, allow_nan=False))
    else:
        _show(report)


def _show(report: ImportReport) -> None:
    if not _OUT.is_terminal:
        _OUT.width = _LOG_WIDTH
    table = Table(box=box.SIMPLE_HEAD)
    table.add_column("joint")
    for heading in (
        "nMSE",
        "RMS error N·m",
        "expected",
        "torque N·m",
        "from … to rad",
        "rad/s",
        "rad/s²",
        "cond.",
    ):
        table.add_column(heading, justify="right")
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
    _OUT.print(table)
    low, high = report.cutoff_hz
    band = f"{low:.3g} Hz" if low == high else f"{low:.3g} to {high:.3g} Hz"
    lines = [
        f"recorded  {r.source}: {r.n_samples} samples in {r.duration_s:.4g} s, "
        f"{r.rate_hz:.4g} Hz, jitter {1e3 * r.jitter_s:.2g} ms"
        for r in report.recordings
    ]
    lines.append(
        f"learned   {report.learned_s:.4g} s in {report.n_parts} unbroken parts, up to {band}, "
        f"by {report.learner}"
    )
    lines.append(
        f"held out  mean nMSE {held_out.nmse.mean():.4f}: {report.fit.n_blocks} blocks of "
        f"{report.fit.block_s:.3g} s, every fifth not learned from in turn"
    )
    lines.append(f"network   {report.network} (predicts torque; revision {report.revision})")
    for line in lines:
        _OUT.print(line, highlight=False, soft_wrap=True, markup=False)
