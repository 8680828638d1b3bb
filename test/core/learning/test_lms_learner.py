"""The paper's learner on a two-link arm in formulas; the contract of all learners is tested elsewhere."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from two_link_trials import INPUT_RANGE, JOINTS, context, trial

from tel_ros.core.errors import TrainingError
from tel_ros.core.learning.inputs import InputRange
from tel_ros.core.learning.learner import TrainingMode, rms
from tel_ros.core.learning.lms_learner import LmsLearner
from tel_ros.core.learning.signals import TrainingSamples

MODES: tuple[TrainingMode, ...] = ("actual", "desired")


def untrained(seed: int = 1, **learning: object) -> LmsLearner:
    return LmsLearner(context(seed, **learning))


def test_practising_the_same_movement_again_and_again_goes_on_reducing_the_held_out_error() -> None:
    learner, held_out = untrained(), trial(first=5)
    errors = [rms(held_out.offset_rad)]
    for _ in range(4):
        learner, _ = learner.trained_on(trial(), "actual")
        errors.append(rms(held_out.offset_rad - learner.predict(held_out.actual)))
    assert errors[1] < 0.5 * errors[0]
    assert errors[4] < 0.2 * errors[0]
    assert errors[4] < errors[1]


def trained(seed: int) -> np.ndarray:
    learner = untrained(seed)
    for _ in range(3):
        learner, _ = learner.trained_on(trial(step=20), "actual")
    return learner.predict(trial(step=7).actual)


def test_another_seed_gives_another_network() -> None:
    assert not np.array_equal(trained(1), trained(2))


def test_each_trial_is_gone_through_in_another_order() -> None:
    """With one order for all trials, the weights would tell which samples came last in it."""
    first, _ = untrained(max_subtrees=0, passes=1).trained_on(trial(), "actual")
    later = untrained(max_subtrees=0, passes=1)
    later.trials_learned = 1
    second, _ = later.trained_on(trial(), "actual")
    assert not np.array_equal(first.predict(trial().actual), second.predict(trial().actual))


@pytest.mark.parametrize(("growth", "limit"), [(1, 2), (4, 6), (0, 5), (2, 0)])
def test_each_tree_grows_by_so_many_subtrees_a_trial_and_never_above_the_limit(
    growth: int, limit: int
) -> None:
    learner = untrained(growth_per_trial=growth, max_subtrees=limit)
    for number in range(1, 4):
        learner, outcome = learner.trained_on(trial(step=50), "actual")
        expected = min(number * growth, limit)
        assert learner.subtrees == (expected, expected)
        assert len(outcome.grown) == 2 * (expected - min((number - 1) * growth, limit))
    for joint in range(2):
        leaves = learner.stored().arrays[f"parents_{joint}"]
        assert len(np.unique(leaves, axis=0)) == len(leaves) == (limit if growth else 0)


def test_what_grew_is_said_in_words() -> None:
    _, outcome = untrained().trained_on(trial(), "actual")
    for joint, text in zip(JOINTS, outcome.grown, strict=True):
        assert text.startswith(f"{joint}: subtree 1 under Gaussian ")
        assert text.endswith(" in the root")
        assert any(f"{j} {k}" in text for j in JOINTS for k in ("position", "velocity", "acceleration"))


def test_more_passes_leave_a_smaller_error_on_the_trial() -> None:
    errors = [untrained(passes=n).trained_on(trial(), "actual")[1].training_rms_after_rad for n in (1, 2, 8)]
    assert errors == sorted(errors, reverse=True)
    assert errors[2] < 0.9 * errors[0]


@pytest.mark.parametrize("mode", MODES)
def test_each_mode_trains_where_it_should(mode: TrainingMode) -> None:
    """Narrow Gaussians, and trajectories so far apart that each has its own: it shows which was trained."""
    wide = InputRange(low=np.full(6, -10.0), high=np.full(6, 10.0))
    learner = LmsLearner(context(input_range=wide, max_subtrees=0, gaussian_width=0.3))
    actual, desired = np.full((60, 6), 6.0), np.full((60, 6), -6.0)
    offset = np.tile([0.3, -0.1], (60, 1))
    learner, _ = learner.trained_on(TrainingSamples(actual, desired, offset), mode)
    trained_at, elsewhere = (actual, desired) if mode == "actual" else (desired, actual)
    # 60 samples, two passes, half of what is left of the error each time.
    np.testing.assert_allclose(learner.predict(trained_at[:1]), [[0.3, -0.1]], atol=1e-9)
    np.testing.assert_allclose(learner.predict(elsewhere[:1]), 0.0, atol=1e-9)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e155, 1e308])
def test_data_that_would_break_the_weights_are_refused_without_a_warning(
    mode: TrainingMode, bad: float
) -> None:
    learner, _ = untrained().trained_on(trial(), "actual")
    offset = trial().offset_rad
    offset[3], offset[4] = bad, -bad
    with pytest.raises(TrainingError, match=r"finite.*; the network is unchanged"):
        learner.trained_on(dataclasses.replace(trial(), offset_rad=offset), mode)


def test_inputs_beyond_the_range_are_predicted_as_at_its_end() -> None:
    learner, _ = untrained().trained_on(trial(), "actual")
    far, end = np.full((1, 6), 1e6), INPUT_RANGE.high[None, :]
    np.testing.assert_array_equal(learner.predict(far), learner.predict(end))


def test_the_uncertainty_is_small_where_it_has_practised_and_grows_towards_what_it_has_not_seen() -> None:
    learner = untrained()
    for duration_s in (11.5, 9.0):
        learner, _ = learner.trained_on(trial(duration_s), "actual")
    std = [learner.std(trial(duration_s).actual).mean() for duration_s in (9.0, 6.0, 4.5)]
    assert std == sorted(std)
    assert std[2] > 1.3 * std[0]


def test_practice_of_a_movement_reduces_its_uncertainty() -> None:
    learner, std = untrained(), []
    for _ in range(4):
        learner, _ = learner.trained_on(trial(), "actual")
        std.append(learner.std(trial(first=5).actual).mean())
    assert std[3] < 0.5 * std[0]
