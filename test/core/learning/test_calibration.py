"""The uncertainty of predictions, as trials that had not been learned have shown it."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from tel_ros.core.learning.calibration import Calibration

RESIDUAL_RAD = np.array([0.02, 0.001])
SCALE_RAD = np.array([0.3, 0.05])


def trial(rng: np.random.Generator, n: int = 4000) -> tuple[np.ndarray, np.ndarray]:
    """Return errors, and the leverages that they have to do with: from nothing up to half of it all."""
    leverage = rng.uniform(0.0, 0.5, (n, 2)) ** 3
    return rng.normal(size=(n, 2)) * np.sqrt(RESIDUAL_RAD**2 + SCALE_RAD**2 * leverage), leverage


def calibrated(rng: np.random.Generator, n_trials: int = 8) -> Calibration:
    calibration = Calibration.unknown(2)
    for _ in range(n_trials):
        error, leverage = trial(rng)
        if calibration.is_known:
            calibration = calibration.tested(error, leverage)
        residual = RESIDUAL_RAD * rng.normal(size=error.shape)
        calibration = calibration.fitted(residual, leverage)
    return calibration


def test_without_experience_errors_may_be_anything() -> None:
    unknown = Calibration.unknown(3)
    assert not unknown.is_known
    np.testing.assert_array_equal(unknown.std(np.array([[0.0, 0.1, 1e9]])), [[np.inf] * 3])


@pytest.mark.parametrize("part", ["all", "little leverage", "much leverage"])
def test_about_95_in_100_errors_lie_within_two_standard_deviations(part: str) -> None:
    rng = np.random.default_rng(1)
    calibration = calibrated(rng)
    error, leverage = trial(rng)
    rows = {"all": slice(None), "little leverage": leverage < 0.01, "much leverage": leverage > 0.05}[part]
    inside = (np.abs(error) < 2.0 * calibration.std(leverage))[rows]
    # 95.4 % of a normal distribution; the scale is known to a few in a hundred.
    assert 0.935 < inside.mean() < 0.97


def test_the_parts_of_the_variance_are_found_joint_by_joint() -> None:
    calibration = calibrated(np.random.default_rng(2))
    np.testing.assert_allclose(np.sqrt(calibration.residual_rad2), RESIDUAL_RAD, rtol=0.05)
    np.testing.assert_allclose(np.sqrt(calibration.scale_rad2), SCALE_RAD, rtol=0.1)


def test_more_leverage_means_more_uncertainty_and_none_leaves_the_residual() -> None:
    calibration = Calibration(np.array([4e-4]), np.array([9e-2]))
    std = calibration.std(np.array([[0.0], [0.01], [1.0]]))[:, 0]
    np.testing.assert_allclose(std, [0.02, np.sqrt(4e-4 + 9e-4), np.sqrt(4e-4 + 9e-2)])


def test_before_the_first_test_what_fitting_left_stands_for_what_is_not_known() -> None:
    error, leverage = trial(np.random.default_rng(3))
    first = Calibration.unknown(2).fitted(0.01 * error, leverage)
    assert first.is_known
    expected = np.mean((0.01 * error) ** 2, axis=0)
    np.testing.assert_allclose(first.residual_rad2, expected)
    np.testing.assert_allclose(np.mean(first.scale_rad2 * leverage, axis=0), expected)


def test_a_test_counts_as_much_as_what_was_known() -> None:
    calibration = Calibration(np.zeros(1), np.array([1.0]))
    tested = calibration.tested(np.array([[2.0], [-2.0]]), np.array([[0.5], [0.5]]))
    np.testing.assert_allclose(tested.scale_rad2, 0.5 * 1.0 + 0.5 * 4.0 / 0.5)
    np.testing.assert_array_equal(tested.residual_rad2, calibration.residual_rad2)


def test_the_first_test_is_all_that_counts_if_nothing_was_known() -> None:
    tested = Calibration.unknown(1).tested(np.full((5, 1), 0.2), np.full((5, 1), 0.1))
    np.testing.assert_allclose(tested.scale_rad2, 0.4)


def test_errors_within_the_residual_say_nothing_about_leverage() -> None:
    calibration = Calibration(np.array([1.0]), np.array([0.5]))
    tested = calibration.tested(np.full((5, 1), 0.1), np.full((5, 1), 0.1))
    np.testing.assert_allclose(tested.scale_rad2, 0.5 * 0.5)


@pytest.mark.filterwarnings("error")
def test_no_leverage_at_all_gives_numbers_all_the_same() -> None:
    known = Calibration.unknown(1).fitted(np.full((4, 1), 0.1), np.zeros((4, 1)))
    tested = known.tested(np.full((4, 1), 0.5), np.zeros((4, 1)))
    for calibration in (known, tested):
        std = calibration.std(np.array([[0.0]]))
        assert np.all(np.isfinite(calibration.scale_rad2))
        np.testing.assert_allclose(std, 0.1)


def test_fitting_again_leaves_what_tests_have_found() -> None:
    calibration = Calibration(np.array([1.0]), np.array([0.5]))
    fitted = calibration.fitted(np.full((3, 1), 0.2), np.full((3, 1), 1.0))
    np.testing.assert_allclose(fitted.residual_rad2, 0.04)
    np.testing.assert_array_equal(fitted.scale_rad2, calibration.scale_rad2)


def test_what_was_known_before_stays_as_it_was() -> None:
    calibration = Calibration(np.array([1.0]), np.array([0.5]))
    same = dataclasses.replace(
        calibration, residual_rad2=calibration.residual_rad2.copy(), scale_rad2=calibration.scale_rad2.copy()
    )
    calibration.tested(np.ones((2, 1)), np.ones((2, 1)))
    calibration.fitted(np.ones((2, 1)), np.ones((2, 1)))
    np.testing.assert_array_equal(calibration.residual_rad2, same.residual_rad2)
    np.testing.assert_array_equal(calibration.scale_rad2, same.scale_rad2)


@pytest.mark.parametrize("calibration", [calibrated(np.random.default_rng(4)), Calibration.unknown(2)])
def test_it_comes_back_from_arrays_of_finite_numbers(calibration: Calibration) -> None:
    arrays = calibration.arrays()
    assert all(np.all(np.isfinite(array)) for array in arrays.values())
    back = Calibration.restored(arrays, 2)
    assert back.is_known == calibration.is_known
    leverage = np.array([[0.0, 0.1], [2.0, 3.0]])
    np.testing.assert_array_equal(back.std(leverage), calibration.std(leverage))


@pytest.mark.parametrize(
    "damaged",
    [np.array([0.1, np.nan]), np.array([0.1, -0.1]), np.array([0.1]), np.zeros((2, 1)), np.empty(0)],
    ids=str,
)
@pytest.mark.parametrize("name", ["calibration_residual", "calibration_scale"])
def test_arrays_that_are_no_calibration_are_refused(name: str, damaged: np.ndarray) -> None:
    arrays = {"calibration_residual": np.ones(2), "calibration_scale": np.ones(2), name: damaged}
    with pytest.raises(ValueError, match="expected 2 numbers of at least 0"):
        Calibration.restored(arrays, 2)


def test_errors_that_are_not_believed_do_not_count() -> None:
    rng = np.random.default_rng(1)
    error, leverage = rng.normal(size=(40, 1)), rng.uniform(0.1, 1.0, size=(40, 1))
    trust = np.repeat([[1.0], [1e-9]], 20, axis=0)
    some, all_of_half = (
        Calibration.unknown(1).fitted(0.1 * error[:n], leverage[:n], t).tested(error[:n], leverage[:n], t)
        for n, t in ((40, trust), (20, None))
    )
    np.testing.assert_allclose(some.residual_rad2, all_of_half.residual_rad2, rtol=1e-6)
    np.testing.assert_allclose(some.scale_rad2, all_of_half.scale_rad2, rtol=1e-6)
