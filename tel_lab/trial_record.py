"""What studies have in common: practice on an arm that may change, and what is kept of trials.

And how demanding a movement is by the exact model.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import click
import numpy as np
from scipy.optimize import brentq

from tel_lab.exact_model import ExactInverseDynamics
from tel_lab.offline import OfflineArm, OfflinePractice
from tel_lab.study import StudyOptions
from tel_lab.tables import Column, Table
from tel_ros.core.config import ArmConfig, Config, SimConfig
from tel_ros.core.learning.inputs import InputRange, query_inputs
from tel_ros.core.learning.registry import learner_kind
from tel_ros.core.practice.session import PractisedTrial
from tel_ros.core.practice.strategy import Ending, PlannedTrial
from tel_ros.core.trajectories.paths import Path
from tel_ros.core.trajectories.trajectory import sample
from tel_ros.core.trial import Outcome, Phase, Trial, TrialGoal, TrialReport
from tel_ros.recording.network_file import learner_context, new_network
from tel_ros.recording.waypoint_file import load_path

_SLOWEST_S = 60.0
_POINTS = 400


@dataclass(frozen=True)
class ArmChange:
    """Another arm from some trial on: the values of the simulation that differ."""

    at_trial: int
    sim: dict[str, float]

    def of(self, config: Config) -> SimConfig:
        return replace(config.sim, **self.sim)  # type: ignore[arg-type]


def practise(
    config: Config, change: ArmChange | None = None, *, exact: bool = False
) -> tuple[list[PractisedTrial[Trial]], Ending]:
    """Run what a configuration asks for, or with the exact model; return the trials and how it ended."""

    def learner(sim: SimConfig) -> Any:
        return ExactInverseDynamics(config, sim) if exact else new_network(config)

    with OfflinePractice(config, load_path(config.path, config.arm), learner(config.sim)) as practice:

        def before_trial(plan: PlannedTrial) -> None:
            if change is not None and plan.index == change.at_trial:
                practice.arm.replace_arm(change.of(config))
                if exact:
                    practice.learner = learner(change.of(config))

        trials = practice.run(before_trial=before_trial)
        assert practice.ending is not None  # it has just run
        return trials, practice.ending


@dataclass(frozen=True)
class TrialRecord:
    """What is kept of a trial: plan, report, and how far a joint came off its path, braking included."""

    plan: PlannedTrial
    report: TrialReport
    excursion_rad: float

    @classmethod
    def of(cls, practised: PractisedTrial[Trial]) -> TrialRecord:
        return cls(practised.plan, practised.report, excursion_rad(practised.trial))

    @property
    def completed(self) -> bool:
        return self.report.outcome == Outcome.COMPLETED

    @property
    def rms_mrad(self) -> float:
        """Tracking error, also of a trial that was aborted."""
        return 1e3 * self.report.rms_error_rad


def practise_unseen(
    config: Config,
    path: Path,
    duration_s: float,
    before_trial: Callable[[OfflinePractice, PlannedTrial], None] = lambda practice, plan: None,
) -> tuple[str, str, tuple[TrialRecord, ...]]:
    """Practise along any path, its inputs covered at a duration; return outcome, message and trials.

    Whatever goes wrong becomes the outcome ``failed``: one seed must not hide how the others went.
    """
    trials: list[TrialRecord] = []
    try:
        goal = sample(path, duration_s, config.control.rate_hz)
        covered = InputRange.covering(goal, config.learning.input_margin)
        context = replace(learner_context(config), input_range=covered)
        with OfflinePractice(config, path, learner_kind(config.learning.name).new(context)) as practice:
            done = practice.run(before_trial=partial(before_trial, practice))
            trials = [TrialRecord.of(practised) for practised in done]
            assert practice.ending is not None  # it has just run
            outcome, message = str(practice.ending.outcome), practice.ending.message
    except Exception as error:
        outcome, message = "failed", f"{type(error).__name__}: {error}"
    return outcome, message, tuple(trials)


TRIALS: list[Column[TrialRecord]] = [
    Column("trial", lambda t: t.plan.index),
    Column("duration [s]", lambda t: t.report.duration_s, ".3f"),
    Column("RMS [mrad]", lambda t: t.rms_mrad, ".2f"),
    Column("largest deviation [rad]", lambda t: t.excursion_rad, ".3f"),
    Column("clipped", lambda t: t.report.saturated_ratio, ".3f"),
    Column("why, and what happened", lambda t: f"{t.plan.reason}  {t.report.message}", left=True),
]


def shown_runs(
    options: StudyOptions,
    function: Callable[..., Any],
    tasks: Mapping[str, tuple[Any, ...]],
    columns: Sequence[Column[Any]],
    trials: Sequence[Column[TrialRecord]] = TRIALS,
) -> Iterator[Any]:
    """Yield runs, each printed in a line; with its trials if they were asked for or went wrong."""
    for run in options.results(function, tasks):
        click.echo("  ".join(f"{column.heading} {column.text(run)}" for column in columns))
        if options.only or run.outcome != "completed" or run.aborts:
            click.echo(Table(trials, run.trials).markdown())
        yield run


def excursion_rad(trial: Trial) -> float:
    """Return the largest deviation of a joint from its path in RUN and while braking after it.

    While it brakes, the deviation is that from where the arm should have been when the trial was stopped.
    """
    n_joints = trial.position_rad.shape[1]
    running = np.flatnonzero(trial.phase == Phase.RUN)
    if len(running) == 0:
        return 0.0
    last = running[-1]
    error = np.abs(trial.position_rad[running] - trial.desired[running, :n_joints])
    braking = last + 1 + np.flatnonzero(trial.phase[last + 1 :] == Phase.STOP)
    beyond = np.abs(trial.position_rad[braking] - trial.desired[last, :n_joints])
    return float(max(error.max(), beyond.max(initial=0.0)))


def effort_share(
    arm: ArmConfig, exact: ExactInverseDynamics, path: Path, duration_s: float, rate_hz: float = 0.0
) -> float:
    """Return the largest share of an effort limit that a path needs, at 400 points or so often a second."""
    desired = sample(path, duration_s, rate_hz or _POINTS / duration_s)
    offset_rad = exact.predict(query_inputs(desired, 0.0))
    effort_nm = np.array(arm.stiffness_nm_per_rad) * offset_rad
    effort_nm -= np.array(arm.damping_nms_per_rad) * desired.velocity_rad_s
    return float(np.max(np.abs(effort_nm) / np.array(arm.effort_limit_nm)))


def fastest_by_speed_s(arm: ArmConfig, path: Path, speed_share: float) -> float:
    """Return the duration at which a path needs that share of a joint's speed limit."""
    velocity_rad_s = sample(path, 1.0, _POINTS).velocity_rad_s
    return float(np.max(np.abs(velocity_rad_s) / np.array(arm.velocity_limit_rad_s))) / speed_share


def duration_at_effort_share(
    arm: ArmConfig, exact: ExactInverseDynamics, path: Path, share: float, fastest_s: float
) -> float:
    """Return the duration at which a path needs that share of an effort limit, but at least ``fastest_s``."""
    if effort_share(arm, exact, path, fastest_s) <= share:
        return fastest_s
    return float(
        brentq(lambda t: effort_share(arm, exact, path, t) - share, fastest_s, _SLOWEST_S, xtol=1e-4)
    )


def fastest_feasible_s(config: Config, sim: SimConfig) -> float:
    """Return the duration that the effort and speed limits allow an arm, by the exact model."""
    arm, path = config.arm, load_path(config.path, config.arm)
    exact = ExactInverseDynamics(config, sim)
    return duration_at_effort_share(arm, exact, path, 1.0, fastest_by_speed_s(arm, path, 1.0))


def exact_trial(config: Config, path: Path, duration_s: float) -> TrialReport:
    """Return how a movement goes with the exact model: what is left is not for a learner to mend."""
    desired = sample(path, duration_s, config.control.rate_hz)
    exact = ExactInverseDynamics(config, config.sim)
    offset_rad = exact.predict(query_inputs(desired, 1.0 / config.control.rate_hz))
    with OfflineArm(config) as arm:
        return arm.run_trial(TrialGoal(1, 1.0, desired, desired.position_rad + offset_rad)).report
