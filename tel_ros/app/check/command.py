"""The command ``tel check``."""

from __future__ import annotations

import json
import sys
from collections import Counter
from functools import partial
from pathlib import Path

import click
from rich.text import Text

from tel_ros.app.config_argument import config_argument, namespace_option, overrides_option
from tel_ros.app.errors import EXIT_INTERRUPTED, Interruption, end
from tel_ros.app.tables import show, table
from tel_ros.core.check.checks import worst
from tel_ros.core.check.evidence import Finding, Verdict
from tel_ros.core.check.pulses import MOST_EFFORT_SHARE, MOST_RANGE_RAD, PulseBounds
from tel_ros.recording.config_file import load_config

_COLOURS = {"OK": "green", "WARNING": "yellow", "NOT_CHECKED": "dim", "WRONG": "bold red"}


@click.command()
@config_argument
@overrides_option("Another value for a key.")
@namespace_option
@click.option("--passive", is_flag=True, help="Only listen: nothing is ever commanded.")
@click.option("--yes", is_flag=True, help="Agree to the pulses beforehand, for scripts.")
@click.option(
    "--effort-share",
    type=float,
    default=PulseBounds.effort_share,
    show_default=True,
    help=f"Strongest pulse as a share of each joint's effort limit, up to {MOST_EFFORT_SHARE}.",
)
@click.option(
    "--range",
    "range_rad",
    type=float,
    default=PulseBounds.range_rad,
    show_default=True,
    help=f"How far any joint may get from where it is, in rad, up to {MOST_RANGE_RAD}.",
)
@click.option("--listen", "listen_s", default=1.5, show_default=True, help="How long to listen first, in s.")
@click.option(
    "--json", "as_json", is_flag=True, help="Print the findings as JSON, and nothing else, on stdout."
)
def check(
    config_file: Path,
    overrides: tuple[str, ...],
    namespace: str,
    passive: bool,
    yes: bool,
    effort_share: float,
    range_rad: float,
    listen_s: float,
    as_json: bool,
) -> None:
    """Find out whether an arm is what its configuration says, before it moves far.

    \b
    tel check config/planar_arm.yaml --passive                       only listens
    tel check config/planar_arm.yaml --set run.arm=external          asks before it pulses the arm

    First it listens: rate, jitter, age, names, units. Then, after you have agreed, each joint gets torque
    pulses that begin very weak, mostly of at most 0.1 s: sign, scale and delay of the effort, wiring,
    velocity against position, and what the driver does when commands stop. Zero effort is commanded at the
    end, on Ctrl-C, as soon as a joint leaves the range that you have agreed to, and when its states stop,
    repeat or freeze. With run.arm=sim the simulated arm is started for the check, in real time.

    Exit codes: 0 nothing is wrong, 1 something is wrong, 2 wrong input (nothing moved), 3 no arm, 130
    interrupted.
    """  # noqa: D301 - click wants the character, not its name
    # Late: `tel --help` needs no ROS.
    from tel_ros.app.check.run import check_arm
    from tel_ros.nodes.robot_description import description_in

    Interruption.watch()

    def agree(announcement: str) -> bool:
        try:
            return yes or click.confirm(announcement, default=False, err=True)
        except click.Abort:
            return False

    bounds = PulseBounds(effort_share, range_rad)
    try:
        config = load_config(config_file, overrides, partial(description_in, namespace))
        findings = check_arm(config, None if passive else bounds, agree, listen_s, namespace)
    except Interruption.errors():
        end("interrupted: zero effort was commanded if anything was", EXIT_INTERRUPTED)
    if as_json:
        keys = ("check", "joint", "verdict", "measured", "expected", "mend")
        plain = [{key: getattr(f, key) for key in keys} | {"verdict": f.verdict.value} for f in findings]
        click.echo(json.dumps({"verdict": worst(findings).value, "findings": plain}, indent=2))
    else:
        _show(findings)
    sys.exit(1 if worst(findings) is Verdict.WRONG else 0)


def _show(findings: list[Finding]) -> None:
    headings = ("check", "joint", "", "measured", "expected")
    rows = [
        (f.check, f.joint, Text(f.verdict.value, _COLOURS[f.verdict.name]), f.measured, f.expected)
        for f in findings
    ]
    mends = [
        f"{f.verdict.value}: {f'{f.check} {f.joint}'.strip()}: {f.mend}"
        for f in findings
        if f.verdict in (Verdict.WRONG, Verdict.WARNING)
    ]
    n = Counter(finding.verdict for finding in findings)
    rest = f"{n[Verdict.WARNING]} warnings, {n[Verdict.NOT_CHECKED]} not checked"
    line = f"nothing wrong, {rest}"
    if n[Verdict.WRONG]:
        line = f"{n[Verdict.WRONG]} things are wrong, {rest}: fix them before the arm moves"
    elif any(f.check == "pulses" and f.verdict is Verdict.NOT_CHECKED for f in findings):
        line = f"nothing wrong as far as listening shows, {rest}"
    show(table(headings, rows, left=headings), *mends, f"verdict  {line}")
