"""Where a trial's error is applied, and whether trees know what they do not know."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
from scipy.stats import spearmanr
from two_link_trials import context, random_movement, trial, truth_rad

from tel_ros.core.errors import TrainingError
from tel_ros.core.learning.learner import outcome, rms, training_pair
from tel_ros.core.learning.least_squares_learner import LeastSquaresLearner
from tel_ros.core.types import FloatArray

TRIAL = trial(step=50, shift_rad=0.2)


@dataclass
class Says:
    """All that an outcome needs of a learner."""

    predict: Callable[[FloatArray], FloatArray]


def test_actual_trajectory_training_asks_for_the_sent_offset_where_the_arm_was() -> None:
    inputs, targets = training_pair("actual", TRIAL, lambda x: x[:, :2] * 7.0)
    np.testing.assert_array_equal(inputs, TRIAL.actual)
    np.testing.assert_array_equal(targets, TRIAL.offset_rad)


def test_desired_trajectory_training_changes_the_output_at_the_desired_trajectory_by_the_same_error() -> None:
    inputs, targets = training_pair("desired", TRIAL, lambda x: x[:, :2] * 7.0)
    np.testing.assert_array_equal(inputs, TRIAL.desired)
    delta = TRIAL.offset_rad - 7.0 * TRIAL.actual[:, :2]
    np.testing.assert_allclose(targets - 7.0 * TRIAL.desired[:, :2], delta, atol=1e-12)  # rounding


def test_where_the_arm_did_what_was_desired_both_modes_ask_for_the_same() -> None:
    exact = trial(step=50)
    (at, wanted), (at_desired, wanted_there) = (
        training_pair(mode, exact, lambda x: np.sin(x[:, :2])) for mode in ("actual", "desired")
    )
    np.testing.assert_array_equal(at, at_desired)
    np.testing.assert_allclose(wanted, wanted_there, atol=1e-12)  # rounding


def test_the_outcome_is_the_error_before_and_after_and_the_change_of_the_command() -> None:
    before, after = Says(lambda x: 0.1 * x[:, :2]), Says(lambda x: 0.1 * x[:, :2] + [0.03, 0.04])
    told = outcome(before, after, TRIAL, ("grew",))
    wanted = TRIAL.offset_rad - 0.1 * TRIAL.actual[:, :2]
    assert told.training_rms_before_rad == pytest.approx(rms(wanted))
    assert told.training_rms_after_rad == pytest.approx(rms(wanted - [0.03, 0.04]))
    assert told.rms_command_change_rad == pytest.approx(0.05 / np.sqrt(2.0))
    assert told.grown == ("grew",)


def test_the_change_of_the_command_is_that_at_the_desired_trajectory() -> None:
    apart = trial(step=50, shift_rad=100.0)
    before, after = Says(lambda x: 0.0 * x[:, :2]), Says(lambda x: np.where(x[:, :2] > 50.0, 0.5, 0.0))
    assert outcome(before, after, apart, ()).rms_command_change_rad == 0.0


@pytest.mark.parametrize("bad", [np.nan, np.inf])
@pytest.mark.parametrize("which", ["before", "after"])
def test_an_answer_that_is_not_finite_is_refused(which: str, bad: float) -> None:
    good, broken = Says(lambda x: 0.0 * x[:, :2]), Says(lambda x: np.full((len(x), 2), bad))
    pair = (broken, good) if which == "before" else (good, broken)
    with pytest.raises(TrainingError, match=r"not finite; the network is unchanged"):
        outcome(*pair, TRIAL, ())


N_MOVEMENTS = 60


@pytest.fixture(scope="module")
def answers() -> list[tuple[np.ndarray, np.ndarray]]:
    """Errors and predicted standard deviations on each of many new movements, slow ones to very fast ones."""
    learner = LeastSquaresLearner(context(weights="least_squares"))
    for duration_s in np.linspace(11.5, 4.5, 6):
        learner, _ = learner.trained_on(trial(duration_s), "actual")
    rng = np.random.default_rng(0)
    movements = [
        random_movement(rng, rng.uniform(2.5, 11.0), rng.uniform(0.3, 1.0)) for _ in range(N_MOVEMENTS)
    ]
    return [(truth_rad(x) - learner.predict(x), learner.std(x)) for x in movements]


def test_the_movements_are_slower_and_faster_than_those_that_were_practised() -> None:
    rng = np.random.default_rng(0)
    fastest = [
        np.abs(random_movement(rng, rng.uniform(2.5, 11.0), rng.uniform(0.3, 1.0))[:, 4:]).max(axis=0)
        for _ in range(N_MOVEMENTS)
    ]
    practised = np.abs(trial(4.5).actual[:, 4:]).max(axis=0)
    share = np.max(fastest / practised, axis=1)
    assert share.min() < 0.1
    assert share.max() > 1.0


def test_movements_with_larger_errors_are_predicted_to_have_them(
    answers: list[tuple[np.ndarray, np.ndarray]],
) -> None:
    error, std = ([rms(part) for part in column] for column in zip(*answers, strict=True))
    assert spearmanr(std, error).statistic > 0.7


def test_about_95_in_100_errors_lie_within_two_standard_deviations(
    answers: list[tuple[np.ndarray, np.ndarray]],
) -> None:
    error, std = (np.vstack(column) for column in zip(*answers, strict=True))
    for joint in range(2):
        assert 0.9 <= np.mean(np.abs(error[:, joint]) < 2.0 * std[:, joint]) <= 1.0


def test_where_it_is_least_certain_errors_are_larger_than_where_it_is_most_certain(
    answers: list[tuple[np.ndarray, np.ndarray]],
) -> None:
    """Sample by sample, and not only because a whole movement is fast."""
    error, std = (np.vstack(column) for column in zip(*answers, strict=True))
    for joint in range(2):
        low, high = np.quantile(std[:, joint], [0.25, 0.75])
        sure, unsure = (rms(error[rows, joint]) for rows in (std[:, joint] < low, std[:, joint] > high))
        assert unsure > 3.0 * sure
