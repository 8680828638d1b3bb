"""The network of all joints, learning a two-link arm in formulas."""

from __future__ import annotations

import dataclasses
from typing import Literal

import numpy as np
import pytest
from two_link import TwoLinkArm, loops

from tel_ros.core.config import LearningConfig
from tel_ros.core.errors import TrainingError
from tel_ros.core.learning.inputs import InputRange, query_inputs
from tel_ros.core.learning.inverse_dynamics import LmsTreeInverseDynamics, training_pair
from tel_ros.core.learning.signals import TrainingSamples

Mode = Literal["actual", "desired"]
MODES: tuple[Mode, ...] = ("actual", "desired")
GOAL = loops(4.5).desired
JOINTS = ("shoulder", "elbow")


def network(seed: int = 1, **learning: object) -> LmsTreeInverseDynamics:
    return LmsTreeInverseDynamics(JOINTS, InputRange.covering(GOAL, 1.3), LearningConfig(**learning), seed)


def truth_rad(inputs: np.ndarray) -> np.ndarray:
    """Return u - q = K⁻¹ (B q̇ + τ) of the arm."""
    q, v, a = np.split(inputs, 3, axis=1)
    return (1.5 * v + TwoLinkArm().inverse_dynamics(q, v, a)) / 15.0


def samples(step: int = 10, first: int = 0, shift_rad: float = 0.0) -> TrainingSamples:
    """Return points of the goal movement; the actual one lies beside it by a shift of all positions."""
    desired = query_inputs(GOAL, 0.002)[first::step]
    actual = desired.copy()
    actual[:, :2] += shift_rad
    return TrainingSamples(actual=actual, desired=desired, offset_rad=truth_rad(actual))


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def test_an_untrained_network_leaves_the_equilibrium_point_at_the_desired_position() -> None:
    predicted = network().predict(query_inputs(GOAL, 0.002))
    assert predicted.shape == GOAL.position_rad.shape
    np.testing.assert_array_equal(predicted, 0.0)


def test_predicting_changes_nothing() -> None:
    trained, _ = network().trained_on(samples(), "actual")
    x = samples(7).actual
    np.testing.assert_array_equal(trained.predict(x), trained.predict(x))


@pytest.mark.parametrize("mode", MODES)
def test_training_reduces_the_error_at_points_of_the_movement_that_it_has_not_seen(mode: Mode) -> None:
    learned, held_out = network(), samples(10, first=5)
    errors = [rms(held_out.offset_rad)]
    for _ in range(4):
        learned, _ = learned.trained_on(samples(), mode)
        errors.append(rms(held_out.offset_rad - learned.predict(held_out.actual)))
    assert errors[1] < 0.5 * errors[0]
    assert errors[4] < 0.2 * errors[0]
    assert errors[4] < errors[1]


def test_the_outcome_reports_the_errors_before_and_after_and_the_change_of_the_command() -> None:
    first, _ = network().trained_on(samples(shift_rad=0.1), "actual")
    trial = samples(9, shift_rad=0.05)
    second, outcome = first.trained_on(trial, "actual")
    before, after = first.predict(trial.actual), second.predict(trial.actual)
    assert outcome.rms_before_rad == pytest.approx(rms(trial.offset_rad - before))
    assert outcome.rms_after_rad == pytest.approx(rms(trial.offset_rad - after))
    change = second.predict(trial.desired) - first.predict(trial.desired)
    assert outcome.rms_command_change_rad == pytest.approx(rms(change))
    assert outcome.rms_after_rad < outcome.rms_before_rad


def test_training_returns_another_network_and_leaves_the_old_one_as_it_was() -> None:
    old = network()
    old, _ = old.trained_on(samples(), "actual")
    x = samples(7).actual
    before, weights = old.predict(x), [tree.weights.copy() for tree in old.trees]
    new, _ = old.trained_on(samples(), "actual")
    assert not np.array_equal(new.predict(x), before)
    np.testing.assert_array_equal(old.predict(x), before)
    for tree, kept in zip(old.trees, weights, strict=True):
        np.testing.assert_array_equal(tree.weights, kept)
        assert tree.n_subtrees == 1
    assert (old.trials_learned, new.trials_learned) == (1, 2)


def trained(seed: int) -> np.ndarray:
    learned = network(seed)
    for _ in range(3):
        learned, _ = learned.trained_on(samples(20), "actual")
    return learned.predict(samples(7).actual)


def test_equal_seeds_give_equal_networks_and_other_seeds_others() -> None:
    one = trained(1)
    np.testing.assert_array_equal(trained(1), one)
    assert not np.array_equal(trained(2), one)


def test_each_trial_is_gone_through_in_another_order() -> None:
    """With one order for all trials, the weights would tell which samples came last in it."""
    once = network(max_subtrees=0, passes=1)
    first, _ = once.trained_on(samples(), "actual")
    again = dataclasses.replace(samples(), offset_rad=samples().offset_rad)
    later = network(max_subtrees=0, passes=1)
    later.trials_learned = 1
    second, _ = later.trained_on(again, "actual")
    assert not np.array_equal(first.predict(again.actual), second.predict(again.actual))


@pytest.mark.parametrize(("growth", "limit"), [(1, 2), (4, 6), (0, 5), (2, 0)])
def test_each_tree_grows_by_so_many_subtrees_a_trial_and_never_above_the_limit(
    growth: int, limit: int
) -> None:
    learned = network(growth_per_trial=growth, max_subtrees=limit)
    for trial in range(1, 4):
        learned, outcome = learned.trained_on(samples(50), "actual")
        expected = min(trial * growth, limit)
        assert [tree.n_subtrees for tree in learned.trees] == [expected, expected]
        assert len(outcome.grown) == 2 * (expected - min((trial - 1) * growth, limit))
    for tree in learned.trees:
        assert len(set(tree.parents)) == limit if growth else tree.parents == []


def test_what_grew_is_said_in_words() -> None:
    _, outcome = network().trained_on(samples(), "actual")
    for joint, text in zip(JOINTS, outcome.grown, strict=True):
        assert text.startswith(f"{joint}: subtree 1 under Gaussian ")
        assert text.endswith(" in the root")
        assert any(f"{j} {k}" in text for j in JOINTS for k in ("position", "velocity", "acceleration"))


def test_more_passes_leave_a_smaller_error_on_the_trial() -> None:
    errors = [network(passes=n).trained_on(samples(), "actual")[1].rms_after_rad for n in (1, 2, 8)]
    assert errors == sorted(errors, reverse=True)
    assert errors[2] < 0.9 * errors[0]


def test_actual_trajectory_training_asks_for_the_sent_offset_where_the_arm_was() -> None:
    trial = samples(shift_rad=0.2)
    inputs, targets = training_pair("actual", trial, lambda x: x[:, :2] * 7.0)
    np.testing.assert_array_equal(inputs, trial.actual)
    np.testing.assert_array_equal(targets, trial.offset_rad)


def test_desired_trajectory_training_changes_the_output_at_the_desired_trajectory_by_the_same_error() -> None:
    trial = samples(shift_rad=0.2)
    inputs, targets = training_pair("desired", trial, lambda x: x[:, :2] * 7.0)
    np.testing.assert_array_equal(inputs, trial.desired)
    delta = trial.offset_rad - 7.0 * trial.actual[:, :2]
    np.testing.assert_allclose(targets - 7.0 * trial.desired[:, :2], delta, atol=1e-12)  # rounding


@pytest.mark.parametrize("mode", MODES)
def test_each_mode_trains_where_it_should(mode: Mode) -> None:
    """Narrow Gaussians, and trajectories so far apart that each has its own: it shows which was trained."""
    wide = InputRange(low=np.full(6, -10.0), high=np.full(6, 10.0))
    learned = LmsTreeInverseDynamics(JOINTS, wide, LearningConfig(max_subtrees=0, gaussian_width=0.3), seed=1)
    actual, desired = np.full((60, 6), 6.0), np.full((60, 6), -6.0)
    offset = np.tile([0.3, -0.1], (60, 1))
    learned, _ = learned.trained_on(TrainingSamples(actual, desired, offset), mode)
    trained_at, elsewhere = (actual, desired) if mode == "actual" else (desired, actual)
    # 60 samples, two passes, half of what is left of the error each time.
    np.testing.assert_allclose(learned.predict(trained_at[:1]), [[0.3, -0.1]], atol=1e-9)
    np.testing.assert_allclose(learned.predict(elsewhere[:1]), 0.0, atol=1e-9)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_data_that_would_break_the_weights_are_refused_and_the_network_stays_as_it_was(
    mode: Mode, bad: float
) -> None:
    learned, _ = network().trained_on(samples(), "actual")
    x = samples(7).actual
    before, trials = learned.predict(x), learned.trials_learned
    offset = samples().offset_rad
    offset[3] = bad
    offset[4] = -bad
    with pytest.raises(
        TrainingError, match=r"the weights of shoulder did not stay finite; the network is unchanged"
    ):
        learned.trained_on(dataclasses.replace(samples(), offset_rad=offset), mode)
    np.testing.assert_array_equal(learned.predict(x), before)
    assert learned.trials_learned == trials


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("absurd", [1e155, 1e308])
def test_finite_data_whose_errors_have_no_finite_size_are_refused(mode: Mode, absurd: float) -> None:
    offset = samples().offset_rad
    offset[3] = absurd
    with pytest.raises(TrainingError, match=r"finite.*; the network is unchanged"):
        network().trained_on(dataclasses.replace(samples(), offset_rad=offset), mode)


def test_inputs_beyond_the_range_are_predicted_as_at_its_end() -> None:
    learned, _ = network().trained_on(samples(), "actual")
    far, end = np.full((1, 6), 1e6), learned.input_range.high[None, :]
    np.testing.assert_array_equal(learned.predict(far), learned.predict(end))
