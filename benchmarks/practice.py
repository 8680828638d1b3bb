"""How well learners learn: the paper's protocol without ROS, for several learners on several arms.

    .venv/bin/python benchmarks/practice.py

Prints the RMS error of every trial and writes the same table to docs/learners_practice.md.
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tel_lab.exact_model import ExactInverseDynamics
from tel_lab.offline import OfflinePractice, PractisedTrial
from tel_ros.core.config import Config, SimConfig
from tel_ros.core.errors import TelError
from tel_ros.core.practice.decisions import PlannedTrial
from tel_ros.core.practice.strategy import make_strategy
from tel_ros.core.trial import Outcome
from tel_ros.recording.config_file import load_config
from tel_ros.recording.new_network import new_network
from tel_ros.recording.waypoint_file import load_path

ROOT = Path(__file__).parents[1]

LEARNERS: dict[str, tuple[str, ...]] = {
    "LMS tree": (),
    "least-squares tree": ("learning.weights=least_squares", "learning.filter=auto"),
    "rigid body": ("learning.name=rigid_body", "learning.filter=auto"),
    "rigid body + least-squares tree": (
        "learning.name=rigid_body+lms_tree",
        "learning.weights=least_squares",
        "learning.filter=auto",
    ),
}
"""What is changed in the configuration for each learner; the first one is the paper's."""

EXACT = "exact model"


@dataclass(frozen=True)
class Scenario:
    """An arm to practise with.

    Args:
        name: for the table.
        overrides: what is changed in the configuration.
        later: what is changed in ``sim`` between two trials.
        later_from: index of the first trial with that change.
    """

    name: str
    overrides: tuple[str, ...] = ()
    later: dict[str, float] = dataclasses.field(default_factory=dict)
    later_from: int = 0


SCENARIOS = (
    Scenario("16-bit encoder"),
    Scenario("0.1 mrad noise, 2 ms delay", ("sim.position_noise_rad=1e-4", "sim.command_delay_s=2e-3")),
    Scenario("1 mrad noise", ("sim.position_noise_rad=1e-3",)),
    Scenario(
        "dry friction 0.3 N·m, 0.5 kg in the hand from trial 9",
        ("sim.coulomb_friction_nm=[0.3, 0.3]",),
        later={"payload_kg": 0.5},
        later_from=9,
    ),
)


def make_learner(config: Config, sim: SimConfig, name: str) -> Any:
    """Return an untrained learner, or the exact model of a simulated arm."""
    return ExactInverseDynamics(config, sim) if name == EXACT else new_network(config)


def practise(config: Config, scenario: Scenario, learner: str) -> list[PractisedTrial]:
    """Run all trials of a configuration."""
    path = load_path(config.path, config.arm)
    with OfflinePractice(config, path, make_learner(config, config.sim, learner)) as practice:

        def change_arm(plan: PlannedTrial) -> None:
            if plan.index != scenario.later_from:
                return
            sim = dataclasses.replace(config.sim, **scenario.later)
            practice.arm.replace_arm(sim)
            if learner == EXACT:
                practice.learner = make_learner(config, sim, learner)

        return practice.run(before_trial=change_arm)


def cells(done: Sequence[PractisedTrial], n_trials: int) -> list[str]:
    """Return the RMS error in mrad of each trial; "abort" for one that was aborted."""

    def cell(practised: PractisedTrial) -> str:
        report = practised.trial.report
        if report.outcome != Outcome.COMPLETED:
            return "abort"
        mrad = 1e3 * report.rms_error_rad
        return f"{mrad:.1f}" if mrad >= 10.0 else f"{mrad:.2f}"

    return [*map(cell, done), *["–"] * (n_trials - len(done))]


def markdown(rows: Sequence[Sequence[str]], columns: Sequence[str]) -> str:
    """Return a table whose columns line up as text."""
    table = [columns, *rows]
    widths = [max(len(row[j]) for row in table) for j in range(len(columns))]

    def line(row: Sequence[str]) -> str:
        padded = [
            text.ljust(width) if j < 2 else text.rjust(width)
            for j, (text, width) in enumerate(zip(row, widths, strict=True))
        ]
        return f"| {' | '.join(padded)} |"

    rule = [
        ("-" if j < 2 else "") + "-" * (width - 1) + ("" if j < 2 else ":") for j, width in enumerate(widths)
    ]
    return "\n".join([line(columns), line(rule), *map(line, rows)])


def document(table: str, options: argparse.Namespace) -> str:
    """Return the page with the table."""
    changes = "\n".join(
        f"- *{name}*: {', '.join(f'`{text}`' for text in overrides) or 'as in the configuration'}"
        for name, overrides in LEARNERS.items()
        if name in options.learners
    )
    return f"""# Learners at practice

RMS error in mrad over both joints of every trial of `config/{options.config.name}`, measured minus desired
position, so that sensor noise is in it. Made by `benchmarks/practice.py` without ROS, tick for tick like the
graph. "abort" is a trial that was aborted; what was recorded until then is learned from.

{changes}
- *{EXACT}*: rigid-body dynamics with the simulated inertia, payload and friction, from the first trial on. It
  knows nothing of encoder, velocity filter and delay, so a learner may do better.

{table}
"""


def main() -> None:
    """Practise with all learners on all arms, print a table and write it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--config", type=Path, default=ROOT / "config" / "paper.yaml")
    parser.add_argument("--learners", nargs="+", default=[*LEARNERS, EXACT], choices=[*LEARNERS, EXACT])
    names = [scenario.name for scenario in SCENARIOS]
    parser.add_argument("--arms", nargs="+", default=names, choices=names)
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="change the protocol")
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "learners_practice.md")
    options = parser.parse_args()
    protocol = ["practice.on_abort=continue", *options.set]
    plan = [trial.duration_s for trial in make_strategy(load_config(options.config, protocol)).preview()]
    rows = [["", "duration [s]", *(f"{duration_s:.1f}" for duration_s in plan)]]
    for scenario in (scenario for scenario in SCENARIOS if scenario.name in options.arms):
        for learner in options.learners:
            started = time.monotonic()
            try:
                overrides = [*protocol, *scenario.overrides, *LEARNERS.get(learner, ())]
                done = practise(load_config(options.config, overrides), scenario, learner)
                rows.append([scenario.name, learner, *cells(done, len(plan))])
            except TelError as error:
                print(f"{learner} on {scenario.name}: {error}", file=sys.stderr)
                rows.append([scenario.name, learner, *["failed"] * len(plan)])
            print(f"{scenario.name}, {learner}: {time.monotonic() - started:.1f} s", file=sys.stderr)
    table = markdown(rows, ["arm", "trial", *(str(k) for k in range(1, len(plan) + 1))])
    print(table)
    options.out.write_text(document(table, options), encoding="utf-8")


if __name__ == "__main__":
    main()
