"""How well learners learn: the paper's protocol without ROS, for several learners on several arms."""

from __future__ import annotations

import click

from tel_lab.study import ROOT, StudyOptions, study
from tel_lab.tables import of_texts
from tel_lab.trial_record import ArmChange, practise
from tel_ros.core.errors import TelError
from tel_ros.core.practice.session import PractisedTrial
from tel_ros.core.practice.strategies import make_strategy
from tel_ros.core.trial import Outcome, Trial
from tel_ros.recording.config_file import load_config

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


ARMS: dict[str, tuple[tuple[str, ...], ArmChange | None]] = {
    "16-bit encoder": ((), None),
    "0.1 mrad noise, 2 ms delay": (("sim.position_noise_rad=1e-4", "sim.command_delay_s=2e-3"), None),
    "1 mrad noise": (("sim.position_noise_rad=1e-3",), None),
    "dry friction 0.3 N·m, 0.5 kg in the hand from trial 9": (
        ("sim.coulomb_friction_nm=[0.3, 0.3]",),
        ArmChange(9, {"payload_kg": 0.5}),
    ),
}
"""What is changed in the configuration, and what on the way."""


def rms_of_trials(overrides: tuple[str, ...], arm: str, learner: str) -> list[str]:
    """Practise; return the RMS error in mrad of each trial, "abort" or "failed", and dashes at the end."""
    arm_overrides, change = ARMS[arm]
    config = load_config(CONFIG, [*overrides, *arm_overrides, *LEARNERS.get(learner, ())])
    n_trials = len(make_strategy(config).preview())
    try:
        cells = [cell(practised) for practised in practise(config, change, exact=learner == EXACT)[0]]
    except TelError as error:
        click.echo(f"{arm}, {learner}: {error}", err=True)
        cells = ["failed"] * n_trials
    return [arm, learner, *cells, *["–"] * (n_trials - len(cells))]


def cell(practised: PractisedTrial[Trial]) -> str:
    report = practised.report
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
    rows += options.results(rms_of_trials, tasks)
    headings = ["arm", "trial", *(str(k) for k in range(1, len(preview) + 1))]
    table = of_texts(headings, rows, 2).markdown()
    click.echo(table)
    own = {name: LEARNERS[name] for name in learners if name != EXACT}
    options.write("learners_practice.md", config=CONFIG.name, learners=own, table=table)
