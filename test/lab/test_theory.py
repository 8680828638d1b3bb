"""The constants of the theorems are found where they can be worked out by hand."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest

from tel_lab.theory.constants import TheoryMonitor
from tel_ros.core.errors import TrainingError
from tel_ros.core.learning.inputs import InputRange
from tel_ros.core.learning.signals import TrainingSamples, TrialSignals
from tel_ros.core.types import FloatArray

INERTIA = np.array([[0.05, 0.01], [0.01, 0.02]])
"""K⁻¹ M [s²]: of a linear arm, u - q = DAMPING q̇ + INERTIA q̈."""

DAMPING = np.array([[0.1, 0.0], [0.0, 0.08]])
PLANT = np.vstack([np.zeros((2, 2)), DAMPING.T, INERTIA.T])
UNIT = np.array([2.0, 1.0, 4.0, 3.0, 20.0, 16.0])
RANGE = InputRange(low=np.array([-1.0, -0.5, -2.0, -1.5, -10.0, -8.0]), high=0.5 * UNIT)
GOAL_DURATION_S = 2.0


@dataclass(frozen=True)
class Linear:
    """A network, or a plant upside down: u - q = weights (q, q̇, q̈)."""

    weights: FloatArray

    def predict(self, inputs: FloatArray) -> FloatArray:
        return inputs @ self.weights

    @classmethod
    def scaled(cls, factor: float) -> Linear:
        """Return the one whose *command* is that of the plant times a factor."""
        return cls(factor * full(PLANT) - full(np.zeros((6, 2))))


UNTRAINED = Linear(np.zeros((6, 2)))
EXACT = Linear(PLANT)


def full(weights: FloatArray) -> FloatArray:
    """Return from (q, q̇, q̈) to u instead of u - q. Shape (6, 2)."""
    return np.vstack([np.eye(2), np.zeros((4, 2))]) + weights


def movement(duration_s: float, share: float = 1.0) -> TrialSignals:
    """Return a trial without any error: two sines of one and two periods, or the first share of it."""
    time_s = np.arange(0.0, share * duration_s + 1e-9, 0.002)
    omega = 2.0 * np.pi / duration_s * np.array([1.0, 2.0])
    amplitude, angle = np.array([0.8, 0.3]), time_s[:, None] * omega
    position = amplitude * np.sin(angle)
    velocity, acceleration = amplitude * omega * np.cos(angle), -(omega**2) * position
    return TrialSignals(
        time_ns=np.round(time_s * 1e9).astype(np.int64) + 7_000_000_000,
        run=np.ones(len(time_s), dtype=bool),
        desired=np.hstack([position, velocity, acceleration]),
        position_rad=position,
        equilibrium_rad=position,
        saturated=np.zeros(position.shape, dtype=bool),
    )


def trial(
    duration_s: float, share: float = 1.0, factor: float = 1.0
) -> tuple[float, float, TrialSignals, TrainingSamples]:
    """Return what a monitor is given of a trial in which the arm moved too far by some factor."""
    signals = movement(duration_s, share)
    actual = factor * signals.desired
    samples = TrainingSamples(actual=actual, desired=signals.desired, offset_rad=EXACT.predict(actual))
    return GOAL_DURATION_S / duration_s, duration_s, signals, samples


def monitor(training: str = "actual", *, exact: bool = True) -> TheoryMonitor:
    return TheoryMonitor(RANGE, training, EXACT.predict if exact else None)  # type: ignore[arg-type]


def rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def test_the_networks_constant_is_the_norm_of_its_command_with_inputs_in_units_of_their_range() -> None:
    network = Linear(np.random.default_rng(1).normal(size=(6, 2)))
    found = monitor().after_trial(*trial(GOAL_DURATION_S), network, network)
    assert found.k_n == pytest.approx(np.linalg.norm(UNIT[:, None] * full(network.weights), 2), rel=1e-6)


def test_the_constant_of_learning_is_the_norm_of_the_change() -> None:
    before, after = Linear(0.5 * PLANT), Linear(0.8 * PLANT)
    found = monitor().after_trial(*trial(GOAL_DURATION_S), before, after)
    assert found.k_l == pytest.approx(np.linalg.norm(0.3 * UNIT[:, None] * PLANT, 2), rel=1e-6)


def test_a_learner_that_learned_nothing_changes_nothing() -> None:
    found = monitor().after_trial(*trial(GOAL_DURATION_S, factor=0.9), UNTRAINED, UNTRAINED)
    assert (found.rate, found.k_l) == (0.0, 0.0)
    assert found.theorem_1 == found.contraction == 1.0


def test_the_plants_constants_are_those_of_its_equation_of_motion() -> None:
    """q̈ = INERTIA⁻¹ (u - q - DAMPING q̇), with everything in units of its range."""
    found = monitor().after_trial(*trial(GOAL_DURATION_S), UNTRAINED, UNTRAINED)
    gain = np.linalg.inv(INERTIA) / UNIT[4:, None]
    by_state = np.vstack([np.eye(4), -gain @ np.hstack([np.eye(2), DAMPING]) * UNIT[:4]])
    assert found.k_u == pytest.approx(np.linalg.norm(gain, 2), rel=1e-6)
    assert found.k_x == pytest.approx(np.linalg.norm(by_state, 2), rel=1e-6)


@pytest.mark.parametrize("share", [1.0, 0.6], ids=["completed", "aborted"])
def test_a_step_in_speed_is_compared_at_equal_phase(share: float) -> None:
    slow, fast = trial(3.0), trial(2.5, share)
    given = monitor()
    given.after_trial(*slow, UNTRAINED, UNTRAINED)
    found = given.after_trial(*fast, UNTRAINED, UNTRAINED)

    # The same phases: sines of 2.5 s, sampled 3 / 2.5 times as densely as those of 3 s.
    y, new_y = (s.desired[::k] for s, k in ((movement(3.0, share), 6), (movement(2.5, share), 5)))
    delta_alpha = 2.0 / 2.5 - 2.0 / 3.0
    command, new_command = y @ full(PLANT), new_y @ full(PLANT)
    assert found.k_alpha == pytest.approx(rms(new_command - command) / delta_alpha, rel=0.01)

    # What the old command does to the arm in its new state.
    acceleration = (command - new_y[:, :2] - new_y[:, 2:4] @ DAMPING.T) @ np.linalg.inv(INERTIA).T
    response = (np.hstack([new_y[:, :4], acceleration]) - y) / UNIT
    size = math.sqrt(float(np.sum(response**2)) / response[:, :2].size)
    assert found.k_p == pytest.approx(size / delta_alpha, rel=0.01)
    assert found.step_rad == pytest.approx((2 * found.k_alpha + found.k_n * found.k_p) * delta_alpha)


def test_theorem_3_adds_the_step_to_what_the_previous_trial_left() -> None:
    given = monitor()
    first = given.after_trial(*trial(3.0, factor=0.9), Linear.scaled(0.9), UNTRAINED)
    second = given.after_trial(*trial(2.5), EXACT, EXACT)
    assert second.command_step_rad == pytest.approx(second.k_alpha * abs(second.alpha - first.alpha))
    left_rad = first.k_r * (first.command_error_rad + second.command_step_rad)
    assert second.theorem_3_rad == pytest.approx(left_rad + second.step_rad)


def test_the_first_trial_has_no_step_and_the_same_speed_again_is_a_step_of_zero() -> None:
    given = monitor()
    first = given.after_trial(*trial(2.5, factor=0.9), Linear.scaled(0.9), UNTRAINED)
    again = given.after_trial(*trial(2.5, factor=0.9), Linear.scaled(0.9), UNTRAINED)
    assert all(map(math.isnan, (first.k_alpha, first.k_p, first.step_rad, first.theorem_3_rad)))
    assert math.isnan(again.k_alpha)
    assert again.command_step_rad == again.step_rad == 0.0
    assert again.theorem_3_rad == pytest.approx(first.k_r * first.command_error_rad)


@pytest.mark.parametrize("overshoot", [-0.3, 0.2, 1.5])
@pytest.mark.parametrize("rate", [0.4, 1.0])
def test_theorem_1_holds_for_desired_training(overshoot: float, rate: float) -> None:
    """A network that commands (1 + c) times too much makes a linear arm move (1 + c) times too far.

    Then R u = -c F y and R̂ û = (1 + c) R u, so k_R = |c|, and training by γ leaves |1 - γ (1 + c)| R u.
    """
    before = Linear.scaled(1.0 + overshoot)
    after = Linear.scaled((1.0 + overshoot) * (1.0 - rate * overshoot))
    given = trial(GOAL_DURATION_S, factor=1.0 + overshoot)
    found = monitor("desired").after_trial(*given, before, after)
    needed_rad = rms(movement(GOAL_DURATION_S).desired @ full(PLANT))
    assert found.command_error_rad == pytest.approx(abs(overshoot) * needed_rad, rel=0.01)
    assert found.training_error_rad == pytest.approx((1.0 + overshoot) * found.command_error_rad)
    assert found.k_r == pytest.approx(abs(overshoot))
    assert found.rate == pytest.approx(rate)
    assert found.contraction == pytest.approx(abs(1.0 - rate * (1.0 + overshoot)))
    assert found.contraction <= found.theorem_1 * (1.0 + 1e-9)


def test_theorem_2_holds_for_actual_training() -> None:
    """The same arm; training changes the network at ŷ = (1 + c) y, so there the change is γ R̂ û."""
    before, after = Linear.scaled(1.3), Linear.scaled(1.3 - 0.5 * 0.3)
    found = monitor("actual").after_trial(*trial(GOAL_DURATION_S, factor=1.3), before, after)
    assert found.rate == pytest.approx(0.5)
    assert found.contraction == pytest.approx(0.5)
    off_path = 0.3 * (movement(GOAL_DURATION_S).desired / UNIT)[:, :4]
    state_error = math.sqrt(float(np.sum(off_path**2)) / off_path[:, :2].size)
    of_learning = found.k_l * (found.k_u + found.k_x * state_error / found.command_error_rad)
    assert found.theorem_2 == pytest.approx(found.theorem_1 + of_learning, rel=0.01)
    assert found.contraction <= found.theorem_2


def test_without_the_true_dynamics_two_trials_tell_as_much() -> None:
    blind, knowing = monitor(exact=False), monitor()
    for duration_s in (3.0, 2.5):
        given = (*trial(duration_s, factor=0.9), Linear.scaled(0.9), Linear.scaled(0.97))
        found, true = blind.after_trial(*given), knowing.after_trial(*given)
    for name in ("k_r", "command_error_rad", "command_error_after_rad", "k_u", "k_x", "k_alpha", "k_p"):
        assert getattr(found, name) == pytest.approx(getattr(true, name), rel=0.02), name


def test_gravity_that_varies_with_posture_is_told_from_inertia_by_two_speeds() -> None:
    heavy = Linear(PLANT + np.vstack([np.diag([-0.3, -0.2]), np.zeros((4, 2))]))
    blind, knowing = monitor(exact=False), TheoryMonitor(RANGE, "actual", heavy.predict)
    for duration_s in (11.0, 10.0):
        alpha, duration_s, signals, samples = trial(duration_s, factor=0.9)
        samples = replace(samples, offset_rad=heavy.predict(samples.actual))
        given = (alpha, duration_s, signals, samples, UNTRAINED, UNTRAINED)
        found, true = blind.after_trial(*given), knowing.after_trial(*given)
    for name in ("k_r", "command_error_rad", "k_u", "k_x", "k_alpha", "k_p"):
        assert getattr(found, name) == pytest.approx(getattr(true, name), rel=0.1), name


def test_the_error_is_seen_even_if_the_network_does_not_see_it() -> None:
    """Lock-up: the network is right at ŷ, training changes nothing, and the command is still wrong."""

    class RightOnlyWhereTheArmWent(Linear):
        def predict(self, inputs: FloatArray) -> FloatArray:
            return np.where(np.abs(inputs[:, 4:]).max() < 6.0, super().predict(inputs), 0.0 * inputs[:, :2])

    network = RightOnlyWhereTheArmWent(PLANT)
    given = trial(GOAL_DURATION_S, factor=0.5)
    y, actual = given[3].desired, given[3].actual
    assert np.abs(actual[:, 4:]).max() < 6.0 < np.abs(y[:, 4:]).max()
    found = monitor(exact=False).after_trial(*given, network, network)
    assert found.training_error_rad == pytest.approx(0.0, abs=1e-12)
    assert found.command_error_rad > 0.1
    assert found.k_r == pytest.approx(1.0)


def test_a_joint_that_never_moved_leaves_the_plants_constants_unknown() -> None:
    alpha, duration_s, signals, samples = trial(GOAL_DURATION_S)
    still = samples.actual.copy()
    still[:, 1::2] = 0.0
    samples = replace(samples, actual=still, desired=still, offset_rad=EXACT.predict(still) * [1.0, 0.0])
    signals = replace(signals, desired=still)
    found = monitor(exact=False).after_trial(alpha, duration_s, signals, samples, UNTRAINED, UNTRAINED)
    assert math.isnan(found.k_u)
    assert math.isnan(found.k_x)
    assert math.isfinite(found.command_error_rad)


def test_samples_that_are_not_finite_are_refused() -> None:
    alpha, duration_s, signals, samples = trial(GOAL_DURATION_S)
    samples = replace(samples, offset_rad=np.full_like(samples.offset_rad, np.nan))
    with pytest.raises(TrainingError, match="not finite"):
        monitor().after_trial(alpha, duration_s, signals, samples, UNTRAINED, UNTRAINED)
