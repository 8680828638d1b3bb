"""Practice runs that the theorems are measured in, and the measuring."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from tel_lab.exact_model import ExactInverseDynamics
from tel_lab.offline import OfflinePractice
from tel_lab.theory.constants import TheoryEstimate, TheoryMonitor
from tel_ros.core.learning.signals import configured_samples
from tel_ros.core.practice.lock_up import LockUpMonitor
from tel_ros.recording.config_file import load_config
from tel_ros.recording.new_network import new_network
from tel_ros.recording.waypoint_file import load_path

ROOT = Path(__file__).parents[1]
TOLERANCE_RAD = 0.005


@dataclass(frozen=True)
class Run:
    """A practice run to be measured.

    Args:
        name: for tables and figures.
        config: file in config/.
        overrides: what is changed in it.
    """

    name: str
    config: str
    overrides: tuple[str, ...] = ()


DIRECT = ("practice.strategy=direct", "practice.on_abort=continue")
RUNS = (
    Run("solved trees, rising speed", "planar_arm.yaml", ("practice.strategy=trajectory_extension",)),
    Run("LMS trees, rising speed", "paper.yaml"),
    Run(
        "narrow Gaussians, goal speed at once",
        "paper.yaml",
        (*DIRECT, "practice.trials=12", "learning.gaussians_per_input=40"),
    ),
    Run(
        "desired training, goal speed at once",
        "paper.yaml",
        (*DIRECT, "practice.trials=5", "learning.training=desired"),
    ),
)


@dataclass(frozen=True)
class Measured:
    """One trial, judged three times.

    Args:
        index: of the trial.
        rms_error_rad: tracking error as reported.
        fitted: as on an arm.
        true: with the exact inverse dynamics.
        network: with the network after training as the model.
        message: of the lock-up monitor.
    """

    index: int
    rms_error_rad: float
    fitted: TheoryEstimate
    true: TheoryEstimate
    network: TheoryEstimate
    message: str


def measure(run: Run) -> list[Measured]:
    """Practise and estimate; trials that nothing was learned from are left out."""
    config = load_config(ROOT / "config" / run.config, list(run.overrides))
    with OfflinePractice(config, load_path(config.path, config.arm), new_network(config)) as practice:
        before = practice.learner
        done = practice.run()
    exact = ExactInverseDynamics(config, config.sim)
    units, training = before.context.input_range, config.learning.training
    fitted, true = TheoryMonitor(units, training), TheoryMonitor(units, training, exact.predict)
    lock_up = LockUpMonitor(TOLERANCE_RAD)
    measured = []
    for trial in done:
        if trial.training is None:
            continue
        signals = trial.trial.signals
        duration_s = trial.plan.movement.own_duration_s
        samples = configured_samples(signals, config.learning)
        given = (trial.plan.alpha, duration_s, signals, samples, before, trial.learner)
        report, outcome = trial.trial.report, trial.training
        measured.append(
            Measured(
                index=report.index,
                rms_error_rad=report.rms_error_rad,
                fitted=fitted.after_trial(*given),
                true=true.after_trial(*given),
                network=TheoryMonitor(units, training, trial.learner.predict).after_trial(*given),
                message=lock_up.after_trial(
                    report.alpha, report.rms_error_rad, outcome.rms_before_rad, outcome.rms_after_rad
                ),
            )
        )
        before = trial.learner
    return measured
