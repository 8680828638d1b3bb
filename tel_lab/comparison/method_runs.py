"""Methods on equal arms: one run is one method on one arm, and does not depend on any other run."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tel_lab.comparison.methods import MethodSpec, chosen, exact_model, goal_movement
from tel_lab.comparison.results import MethodRun, TrialResult
from tel_lab.comparison.servo_methods import Feedforward, Method
from tel_lab.offline import OfflineArm, OfflinePractice
from tel_lab.random_arm import vary
from tel_lab.random_path import random_smooth_path
from tel_lab.study import StudyOptions, assignments
from tel_lab.time_bound import time_bound
from tel_ros.core.config import Config
from tel_ros.core.errors import ConfigError, TrainingError
from tel_ros.core.learning.signals import learning_record
from tel_ros.core.practice.strategy import Movement, PlannedTrial
from tel_ros.core.trajectories.trajectory import DesiredTrajectory, sample
from tel_ros.core.trial import Outcome, TrialGoal, TrialReport
from tel_ros.core.types import NS_PER_S
from tel_ros.recording.config_file import load_config
from tel_ros.recording.network_file import new_network
from tel_ros.recording.waypoint_file import load_path


@dataclass(frozen=True)
class Task:
    """What is compared: practice of a configuration, with other values as for ``--set``, on a budget."""

    config_file: Path
    settings: tuple[str, ...] = ()
    trials: int = 15


@dataclass(frozen=True)
class Comparison:
    """All runs of each method in the order of the seeds, and how long they took."""

    methods: tuple[MethodSpec, ...]
    runs: dict[str, tuple[MethodRun, ...]]
    wall_s: float

    @property
    def arm_s(self) -> float:
        return sum(run.arm_s for runs in self.runs.values() for run in runs)

    @property
    def cpu_s(self) -> float:
        return sum(run.cpu_s for runs in self.runs.values() for run in runs)


def compare(task: Task, methods: Sequence[str] = (), n_seeds: int = 10, jobs: int = 1) -> Comparison:
    """Run every method (all if none is named) on every arm; the results do not depend on ``jobs``.

    Raises:
        ConfigError: there is no such method, or a value of the configuration is wrong.
        InputFileError: the configuration, or a file that it names, cannot be read.
        TaskFailedError: a run broke down.
    """
    if n_seeds < 1:
        raise ConfigError("--seeds", n_seeds, "a whole number of at least 1")
    specs = tuple(chosen(methods))
    for spec in specs:  # before any work begins
        config = method_config(task, spec, 1)
        with OfflineArm(config):
            goal_movement(config)
            new_network(config)
    started = time.monotonic()
    items = [(spec.name, seed) for seed in range(1, n_seeds + 1) for spec in specs]
    tasks = {f"{name} on arm {seed}": (task, name, seed) for name, seed in items}
    runs: dict[str, tuple[MethodRun, ...]] = {spec.name: () for spec in specs}
    for run in StudyOptions(jobs=jobs).results(run_method, tasks):
        runs[run.method] += (run,)
    return Comparison(specs, runs, time.monotonic() - started)


def method_config(task: Task, spec: MethodSpec, seed: int) -> Config:
    """Return the configuration of one run: the arm of that seed, and the settings of the method."""
    own = (f"practice.trials={task.trials}", "practice.on_abort=continue", f"seed={seed}")
    config = load_config(task.config_file, (*task.settings, *own, *assignments(spec.settings)))
    arm, (on_stiffness, on_damping) = config.arm, spec.stiffer
    stiffer = dataclasses.replace(
        arm,
        stiffness_nm_per_rad=tuple(on_stiffness * value for value in arm.stiffness_nm_per_rad),
        damping_nms_per_rad=tuple(on_damping * value for value in arm.damping_nms_per_rad),
    )
    return dataclasses.replace(config, sim=vary(config.sim, seed, n_joints=len(arm.joints)), arm=stiffer)


def run_method(task: Task, name: str, seed: int) -> MethodRun:
    """Practise with one method on the arm of one seed, then test what was learned."""
    (spec,) = chosen([name])
    config = method_config(task, spec, seed)
    started = time.process_time()
    method = spec.make(config)
    trials, final, new_path, message = (
        _repeated(config, method, spec.movement(config), seed) if method else _practised(config, seed)
    )
    return MethodRun(
        method=name,
        seed=seed,
        goal_duration_s=final.duration_s if spec.is_fastest else config.practice.goal_duration_s,
        tolerance_rad=config.practice.tolerance_rad,
        trials=tuple(trials),
        final=final,
        new_path=new_path,
        bound_s=time_bound(config.arm, exact_model(config), load_path(config.path, config.arm)).duration_s,
        cpu_s=time.process_time() - started,
        message=message,
    )


_Achieved = tuple[list[TrialResult], TrialResult, TrialResult | None, str]


def _repeated(config: Config, method: Method, desired: DesiredTrajectory, seed: int) -> _Achieved:
    """Run a method that executes the same movement in every trial; one is enough if it does not learn."""
    messages, trials = list[str](), []
    with OfflineArm(config) as arm:
        for index in range(1, (config.practice.trials if method.learns else 1) + 1):
            trial = arm.run_trial(TrialGoal(index, 1.0, desired, method.command(desired)))
            trials.append(_result(trial.report))
            try:
                method.learn(learning_record(trial), trial.report.outcome == Outcome.COMPLETED)
            except TrainingError as error:
                messages.append(f"trial {index} was not learned from: {error}")
        return trials, *_tested(arm, method, desired, config, seed), "; ".join(messages)


def _practised(config: Config, seed: int) -> _Achieved:
    """Run the configured practice strategy with the configured learner.

    If it has reached its goal before the budget is used up, it goes on at the goal speed with what is left:
    so the errors at the end are those after equally many trials for all methods.
    """
    path = load_path(config.path, config.arm)
    with OfflinePractice(config, path, new_network(config)) as practice:
        done, ending = practice.run(), practice.ending
        assert ending is not None  # it has just run
        is_fastest = config.practice.is_fastest
        if ending.outcome == "completed":
            goal = done[-1].plan.movement if is_fastest else Movement(config.practice.goal_duration_s)
            for index in range(len(done) + 1, config.practice.trials + 1):
                done.append(practice.run_trial(PlannedTrial(index, 1.0, goal)))
        trials = [_result(practised.report) for practised in done]
        learned = Feedforward(practice.learner.predict, 1.0 / config.control.rate_hz)
        wanted = (
            practice.session.commanded(done[-1].plan).goal.desired if is_fastest else goal_movement(config)
        )
        return trials, *_tested(practice.arm, learned, wanted, config, seed), ending.message


def _tested(
    arm: OfflineArm, method: Method, wanted: DesiredTrajectory, config: Config, seed: int
) -> tuple[TrialResult, TrialResult | None]:
    """Execute the wanted movement and one that was never practised; nothing is learned from either."""

    def tested(desired: DesiredTrajectory) -> TrialResult:
        return _result(arm.run_trial(TrialGoal(0, 1.0, desired, method.command(desired))).report)

    return tested(wanted), tested(new_movement(config, seed)) if method.transfers else None


def new_movement(config: Config, seed: int) -> DesiredTrajectory:
    """Return a movement along another path, in the range of positions of the practised one and as fast.

    It is as fast as it can be without exceeding the largest speed or acceleration of the wanted movement in
    any joint: so it needs no more than was practised, only something else.
    """
    practised = goal_movement(config)
    low, high = practised.position_rad.min(axis=0), practised.position_rad.max(axis=0)
    path = random_smooth_path(seed, low, high)
    rate_hz, duration_s = config.control.rate_hz, config.practice.goal_duration_s
    other = sample(path, duration_s, rate_hz)
    faster = np.abs(other.velocity_rad_s).max(axis=0) / np.abs(practised.velocity_rad_s).max(axis=0)
    harder = np.abs(other.acceleration_rad_s2).max(axis=0) / np.abs(practised.acceleration_rad_s2).max(axis=0)
    return sample(path, duration_s * max(faster.max(), np.sqrt(harder.max())), rate_hz)


def _result(report: TrialReport) -> TrialResult:
    return TrialResult(
        duration_s=report.duration_s,
        completed=report.outcome == Outcome.COMPLETED,
        rms_error_rad=report.rms_error_rad,
        max_error_rad=report.max_error_rad,
        arm_s=(report.end_ns - report.start_ns) / NS_PER_S,
    )
