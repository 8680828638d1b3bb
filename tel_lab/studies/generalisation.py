"""What practice of some paths is worth on others: movements at goal speed along paths not practised."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from tel_lab.offline import OfflineArm
from tel_lab.random_path import random_smooth_path
from tel_lab.study import ROOT, Chapter, StudyOptions, study
from tel_lab.tables import of_texts
from tel_lab.trial_record import fastest_by_speed_s
from tel_ros.core.config import Config
from tel_ros.core.errors import TrainingError
from tel_ros.core.learning.inputs import InputRange
from tel_ros.core.learning.learner import Learner
from tel_ros.core.learning.registry import learner_kind
from tel_ros.core.practice.session import predicted, trained
from tel_ros.core.trajectories.trajectory import DesiredTrajectory, sample
from tel_ros.core.trial import Outcome, Trial, TrialGoal
from tel_ros.core.types import FloatArray
from tel_ros.recording.config_file import load_config
from tel_ros.recording.network_file import learner_context
from tel_ros.recording.waypoint_file import load_path


class Arm(NamedTuple):
    """A configuration, and how far around its path others may lie [rad]; inf: in all of their ranges."""

    config: str
    around_rad: float


ARMS = {"Two joints": Arm("planar_arm.yaml", np.inf), "Seven joints": Arm("kuka_iiwa.yaml", 0.3)}
LEARNERS = {
    "polynomial": "learning.name=polynomial",
    "rigid_body": "learning.name=rigid_body",
    "rigid_body+lms_tree": "learning.name=rigid_body+lms_tree",
    "lms_tree": "learning.weights=lms",
}
"""Without a model, with kinematics, the same with trees on top, and the paper's."""
PROTOCOL = ("learning.name=lms_tree", "learning.filter=auto", "control.path_tolerance_rad=2.0")
"""Trials end only where they would also end on a table: without learning some movements are far off."""
AFTER, UNPRACTISED, FIRST_SEED = (1, 3, 10), 20, 40_001
STEPS = (2.5, 1.5, 1.0)
"""A path is practised once at each of these, times its goal duration."""
MARGIN_RAD, SPEED_SHARE = 0.3, 0.6
SMALLER, WORSE = 10.0, 1.2


def movements(config: Config, around_rad: float, n: int) -> list[tuple[DesiredTrajectory, ...]]:
    """Return movements along random paths, each at all steps."""
    arm = config.arm
    shown = load_path(config.path, arm).evaluate(np.linspace(0.0, 1.0, 200))[0]
    low = np.maximum(np.array(arm.position_min_rad) + MARGIN_RAD, shown.min(axis=0) - around_rad)
    high = np.minimum(np.array(arm.position_max_rad) - MARGIN_RAD, shown.max(axis=0) + around_rad)
    found = []
    for seed in range(FIRST_SEED, FIRST_SEED + n):
        path = random_smooth_path(seed, low, high)
        goal_s = max(config.practice.goal_duration_s, fastest_by_speed_s(arm, path, SPEED_SHARE))
        found.append(tuple(sample(path, goal_s * step, config.control.rate_hz) for step in STEPS))
    return found


def executed(config: Config, learner: Learner, desired: DesiredTrajectory) -> Trial:
    """Let the simulated arm, at rest at the start, follow what a learner commands, to whatever end."""
    equilibrium_rad = predicted(learner, desired, config.control.rate_hz).equilibrium_rad
    with OfflineArm(config) as arm:
        return arm.run_trial(TrialGoal(1, 1.0, desired, equilibrium_rad))


def errors_rad(config: Config, learner: Learner, tests: list[DesiredTrajectory]) -> FloatArray:
    """Return the tracking error (RMS) of each movement; inf of one that was aborted."""
    reports = [executed(config, learner, desired).report for desired in tests]
    done = [report.outcome == Outcome.COMPLETED for report in reports]
    return np.where(done, [report.rms_error_rad for report in reports], np.inf)


def learned(config: Config, practised: list[tuple[DesiredTrajectory, ...]], learner: Learner) -> Learner:
    """Return a learner after practice of further paths; it also learns from trials that ended early."""
    for path in practised:
        for desired in path:
            trial = executed(config, learner, desired)
            with suppress(TrainingError):  # hardly anything was recorded
                learner, _ = trained(learner, trial, config)
    return learner


def chapter(name: str, quick: bool, overrides: tuple[str, ...]) -> Chapter:
    """Practise with each learner on one arm; return its tables, and what was wanted."""
    file, around_rad = ARMS[name]
    after, n_tests = (AFTER[:1], 2) if quick else (AFTER, UNPRACTISED)

    def configured(learner: str) -> Config:
        return load_config(ROOT / "config" / file, [*PROTOCOL, LEARNERS[learner], *overrides])

    every = movements(configured("lms_tree"), around_rad, after[-1] + n_tests)
    practised, tests = every[: after[-1]], [path[-1] for path in every[after[-1] :]]
    errors: dict[tuple[str, int], FloatArray] = {}
    for learner in LEARNERS:
        config = configured(learner)
        covered = [InputRange.covering(path[-1], config.learning.input_margin) for path in every]
        low, high = (np.array([getattr(each, end) for each in covered]) for end in ("low", "high"))
        context = replace(learner_context(config), input_range=InputRange(low.min(axis=0), high.max(axis=0)))
        network = learner_kind(config.learning.name).new(context)
        if not errors:
            # Until an abort: without learning the error is that large at least.
            unlearned = np.array([executed(config, network, test).report.rms_error_rad for test in tests])
        for before, now in pairwise((0, *after)):
            network = learned(config, practised[before:now], network)
            errors[learner, now] = errors_rad(config, network, tests)
    rows = [["none", "0", *spread(unlearned), "", ""]]
    for (learner, now), found in errors.items():
        smaller = unlearned / found
        rows.append([learner, str(now), *spread(found), f"{np.median(smaller):.1f}", f"{smaller.min():.1f}"])
    headings = ["learner", "paths practised", "error, median [mrad]", "worst [mrad]"]
    table = of_texts([*headings, "times smaller, median", "least"], rows).markdown()
    times = {now: errors["rigid_body+lms_tree", now] / errors["rigid_body", now] for now in after}
    ratios = [[str(now), f"{np.median(ratio):.2f}", f"{ratio.max():.2f}"] for now, ratio in times.items()]
    trees = of_texts(["paths practised", "median", "worst"], ratios, 0).markdown()
    factor = float(np.median(unlearned / errors["polynomial", after[-1]]))
    worst = float(max(ratio.max() for ratio in times.values()))
    text = f"`config/{file}`\n\n{table}\n\nError with trees over that of rigid links alone:\n\n{trees}"
    return text, [
        (f"without a model, errors at least {SMALLER:.0f} times smaller", f"{factor:.1f}", factor >= SMALLER),
        (f"trees: never more than {WORSE} times the error without", f"{worst:.2f}", worst <= WORSE),
    ]


def spread(errors: FloatArray) -> tuple[str, str]:
    """Return median and largest of some errors [mrad]."""
    median, largest = (
        f"{1e3 * x:.2f}" if np.isfinite(x) else "aborted" for x in (np.median(errors), errors.max())
    )
    return median, largest


@study()
def generalisation(options: StudyOptions) -> None:
    """Practise some paths, then run others at goal speed.

    --only takes arms.
    """
    options.chapters(
        "generalisation.md",
        list(ARMS),
        chapter,
        options.quick,
        options.overrides,
        learners=LEARNERS,
        arms=ARMS,
        protocol=PROTOCOL,
        steps=STEPS,
        speed_share=SPEED_SHARE,
        unpractised=UNPRACTISED,
    )
