"""How well learners learn: the paper's protocol without ROS, for several learners on several arms."""

from __future__ import annotations

import dataclasses
from typing import Any

import click

from tel_lab.exact_model import ExactInverseDynamics
from tel_lab.offline import OfflinePractice, PractisedTrial
from tel_lab.study import ROOT, StudyOptions, study
from tel_lab.tables import of_texts
from tel_lab.workers import Failure
from tel_ros.core.config import Config, SimConfig
from tel_ros.core.practice.decisions import PlannedTrial
from tel_ros.core.practice.strategy import make_strategy
from tel_ros.core.trial import Outcome
from tel_ros.recording.config_file import load_config
from tel_ros.recording.new_network import new_network
from tel_ros.recording.waypoint_file import load_path

CONFIG = ROOT / "config" / "paper.yaml"
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


@dataclasses.dataclass(frozen=True)
class Scenario:
    """An arm to practise with.

    Args:
        overrides: what is changed in the configuration.
        later: what is changed in ``sim`` between two trials.
        later_from: index of the first trial with that change.
    """

    overrides: tuple[str, ...] = ()
    later: dict[str, float] = dataclasses.field(default_factory=dict)
    later_from: int = 0


ARMS = {
    "16-bit encoder": Scenario(),
    "0.1 mrad noise, 2 ms delay": Scenario(("sim.position_noise_rad=1e-4", "sim.command_delay_s=2e-3")),
    "1 mrad noise": Scenario(("sim.position_noise_rad=1e-3",)),
    "dry friction 0.3 N·m, 0.5 kg in the hand from trial 9": Scenario(
        ("sim.coulomb_friction_nm=[0.3, 0.3]",), later={"payload_kg": 0.5}, later_from=9
    ),
}


def practise(overrides: tuple[str, ...], arm: str, learner: str) -> list[str]:
    """Run all trials; return the RMS error in mrad of each, or "abort"."""
    scenario = ARMS[arm]
    config = load_config(CONFIG, [*overrides, *scenario.overrides, *LEARNERS.get(learner, ())])

    def make_learner(config: Config, sim: SimConfig) -> Any:
        return ExactInverseDynamics(config, sim) if learner == EXACT else new_network(config)

    with OfflinePractice(
        config, load_path(config.path, config.arm), make_learner(config, config.sim)
    ) as practice:

        def change_arm(plan: PlannedTrial) -> None:
            if plan.index != scenario.later_from:
                return
            sim = dataclasses.replace(config.sim, **scenario.later)  # type: ignore[arg-type]
            practice.arm.replace_arm(sim)
            if learner == EXACT:
                practice.learner = make_learner(config, sim)

        return [cell(practised) for practised in practice.run(before_trial=change_arm)]


def cell(practised: PractisedTrial) -> str:
    """Return the RMS error of a trial in mrad."""
    report = practised.trial.report
    if report.outcome != Outcome.COMPLETED:
        return "abort"
    mrad = 1e3 * report.rms_error_rad
    return f"{mrad:.1f}" if mrad >= 10.0 else f"{mrad:.2f}"


@study()
def learners_practice(options: StudyOptions) -> None:
    """Practise with several learners on several arms.

    --only takes learners.
    """
    protocol = ("practice.on_abort=continue", *options.overrides)
    preview = make_strategy(load_config(CONFIG, protocol)).preview()
    learners = options.selected([*LEARNERS, EXACT])
    arms = list(ARMS)[: 1 if options.quick else None]
    tasks = {f"{arm}, {learner}": (protocol, arm, learner) for arm in arms for learner in learners}
    rows = [["", "duration [s]", *(f"{trial.duration_s:.1f}" for trial in preview)]]
    for name, found in options.run(practise, tasks):
        _, arm, learner = tasks[name]
        if isinstance(found, Failure):
            click.echo(f"{name}: {found.message}", err=True)
            found = ["failed"] * len(preview)
        rows.append([arm, learner, *found, *["–"] * (len(preview) - len(found))])
    headings = ["arm", "trial", *(str(k) for k in range(1, len(preview) + 1))]
    table = of_texts(headings, rows, 2).markdown()
    click.echo(table)
    changes = "\n".join(
        f"- *{name}*: {', '.join(f'`{text}`' for text in LEARNERS[name]) or 'as in the configuration'}"
        for name in learners
        if name != EXACT
    )
    options.write(
        "learners_practice.md",
        f"""# Learners at practice

RMS error in mrad over both joints of every trial of `config/{CONFIG.name}`, measured minus desired
position, so that sensor noise is in it. Made by `{options.command}` without ROS, tick for tick like the
graph. "abort" is a trial that was aborted; what was recorded until then is learned from.

{changes}
- *{EXACT}*: rigid-body dynamics with the simulated inertia, payload and friction, from the first trial on. It
  knows nothing of encoder, velocity filter and delay, so a learner may do better.

{table}
""",
    )
