"""What the theorems speak of, estimated as on an arm, against the simulated arm's exact inverse dynamics."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from tel_lab.exact_model import ExactInverseDynamics
from tel_lab.offline import OfflinePractice
from tel_lab.theory.constants import TheoryEstimate, TheoryMonitor
from tel_ros.core.learning.signals import configured_samples, learning_record
from tel_ros.core.practice.lock_up import LockUpMonitor
from tel_ros.recording.config_file import load_config
from tel_ros.recording.network_file import new_network
from tel_ros.recording.waypoint_file import load_path

PAPER = Path(__file__).parents[2] / "config" / "paper.yaml"
COARSE = ("control.rate_hz=250", "sim.physics_rate_hz=1000")
DIRECT = ("practice.strategy=direct", "practice.on_abort=continue")
TOLERANCE_RAD = 0.005
pytestmark = pytest.mark.timeout(120)


@dataclass(frozen=True)
class Judged:
    """A practice run, trial by trial: as estimated on an arm, as it is, and what the lock-up monitor said."""

    fitted: list[TheoryEstimate]
    true: list[TheoryEstimate]
    messages: list[str]

    def column(self, which: str, name: str) -> np.ndarray:
        return np.array([getattr(estimate, name) for estimate in getattr(self, which)])


def practise(*overrides: str) -> Judged:
    config = load_config(PAPER, [*COARSE, *overrides])
    with OfflinePractice(config, load_path(config.path, config.arm), new_network(config)) as practice:
        before = practice.learner
        done = practice.run()
    units, training = before.context.input_range, config.learning.training
    exact = ExactInverseDynamics(config, config.sim)
    fitted, true = TheoryMonitor(units, training), TheoryMonitor(units, training, exact.predict)
    monitor, judged = LockUpMonitor(TOLERANCE_RAD), Judged([], [], [])
    for trial in done:
        assert trial.training is not None
        signals, report = learning_record(trial.trial), trial.trial.report
        samples = configured_samples(signals, config.learning)
        after = practice.after[trial.plan.index]
        given = (report.alpha, report.duration_s, signals, samples, before, after)
        judged.fitted.append(fitted.after_trial(*given))
        judged.true.append(true.after_trial(*given))
        judged.messages.append(
            monitor.after_trial(
                report.alpha,
                report.rms_error_rad,
                trial.training.training_rms_before_rad,
                trial.training.training_rms_after_rad,
            )
        )
        before = after
    return judged


@pytest.fixture(scope="module")
def rising_speed() -> Judged:
    return practise("practice.trials=5", "practice.first_duration_s=9.0")


@pytest.fixture(scope="module")
def desired_training() -> Judged:
    return practise(*DIRECT, "practice.trials=3", "learning.training=desired")


@pytest.fixture(scope="module")
def narrow_gaussians() -> Judged:
    # As many samples as the 40 Gaussians of each input need.
    return practise(*DIRECT, "practice.trials=9", "learning.gaussians_per_input=40", "control.rate_hz=500")


@pytest.mark.parametrize("name", ["command_error_rad", "command_error_after_rad", "k_alpha"])
def test_what_the_command_lacks_is_estimated_without_knowing_the_arm(rising_speed: Judged, name: str) -> None:
    fitted, true = (rising_speed.column(which, name) for which in ("fitted", "true"))
    known = np.isfinite(true)
    assert np.count_nonzero(known) >= 4
    np.testing.assert_allclose(fitted[known], true[known], rtol=0.15)


@pytest.mark.parametrize("run", ["rising_speed", "desired_training", "narrow_gaussians"])
def test_k_r_is_estimated_without_knowing_the_arm(run: str, request: pytest.FixtureRequest) -> None:
    judged = request.getfixturevalue(run)
    np.testing.assert_allclose(judged.column("fitted", "k_r"), judged.column("true", "k_r"), atol=0.12)


def test_theorem_1_tells_the_fate_of_desired_training(desired_training: Judged) -> None:
    """At goal speed from the start k_R is above 1, and training makes the command worse; it was to be so."""
    assert np.all(desired_training.column("fitted", "k_r") > 1.1)
    true = desired_training.column("true", "contraction")
    assert np.all(true > 1.1)
    np.testing.assert_allclose(desired_training.column("fitted", "theorem_1"), true, rtol=0.1)


def test_the_bounds_of_theorems_2_and_3_hold(rising_speed: Judged) -> None:
    assert np.all(rising_speed.column("true", "theorem_2") >= rising_speed.column("true", "contraction"))
    command_error = rising_speed.column("true", "command_error_rad")
    assert np.all(rising_speed.column("true", "theorem_3_rad")[1:] >= command_error[1:])


def test_lock_up_is_k_r_near_1_and_is_noticed(narrow_gaussians: Judged) -> None:
    assert narrow_gaussians.messages[:8] == [""] * 8
    assert str(narrow_gaussians.messages[8]).startswith("learning lock-up")
    last = narrow_gaussians.fitted[-1]
    assert 0.9 < last.k_r < 1.0
    assert last.training_error_rad < 0.2 * last.command_error_rad


def test_divergence_is_noticed_and_rising_speed_is_neither(
    desired_training: Judged, rising_speed: Judged
) -> None:
    assert str(desired_training.messages[-1]).startswith("learning diverges")
    assert rising_speed.messages == [""] * 5
