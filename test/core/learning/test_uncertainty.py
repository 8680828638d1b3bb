"""Whether trees know what they do not know: about movements of other shapes and speeds than practised."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import spearmanr
from two_link_trials import context, random_movement, rms, trial, truth_rad

from tel_ros.core.learning.least_squares_learner import LeastSquaresLearner

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
