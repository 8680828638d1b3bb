"""What earlier trials decide: held-out samples, changes of the arm."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tel_ros.core.learning.experience import alternate_slices, arm_has_changed, better_strength


@pytest.mark.parametrize("n", [10, 100, 1003])
def test_half_of_the_samples_are_held_out_in_slices_between_those_that_are_learned_from(n: int) -> None:
    learned = alternate_slices(n)
    assert learned.shape == (n,)
    assert abs(learned.mean() - 0.5) < 0.01
    borders = np.flatnonzero(np.diff(learned.astype(int)))
    assert len(borders) == 9
    assert np.diff(borders).min() >= n // 10
    assert learned[0]
    assert not learned[-1]


@pytest.mark.parametrize("n", range(2, 10))
def test_however_few_samples_some_are_learned_from_and_some_held_out(n: int) -> None:
    learned = alternate_slices(n)
    assert learned.any()
    assert not learned.all()


def test_no_samples_have_no_slices() -> None:
    assert alternate_slices(0).shape == (0,)


@pytest.mark.parametrize("best", [0.1, 1.0, 10.0])
def test_of_three_strengths_the_one_with_the_least_held_out_error_is_taken(best: float) -> None:
    def error_with(strength: float) -> float:
        return 1.0 + math.log10(strength / best) ** 2

    assert better_strength(1.0, error_with) == (pytest.approx(best), pytest.approx(1.0))


def test_the_best_strength_is_approached_by_a_factor_of_ten_at_a_time() -> None:
    strength = 1.0
    for expected in (0.1, 0.01, 0.001, 0.001):
        strength, _ = better_strength(strength, lambda s: 1.0 + math.log10(s / 1e-3) ** 2)
        assert strength == pytest.approx(expected)


def test_a_gain_that_is_not_clear_changes_nothing() -> None:
    assert better_strength(1.0, lambda s: 1.0 if s == 1.0 else 0.985) == (1.0, 1.0)
    assert better_strength(1.0, lambda s: 1.0 if s == 1.0 else 0.975)[0] != 1.0


def test_an_error_that_is_no_number_is_no_gain() -> None:
    assert better_strength(1.0, lambda s: 1.0 if s == 1.0 else math.nan) == (1.0, 1.0)


@pytest.mark.parametrize(("falls", "limit"), [(True, 1e4), (False, 1e-7)])
def test_the_strength_stays_where_it_makes_sense(falls: bool, limit: float) -> None:
    strength = 1.0
    for _ in range(30):
        strength, _ = better_strength(strength, lambda s: 1.0 / s if falls else s)
    # Within a factor of ten, because it is reached in steps of ten.
    assert min(limit, 1.0 / limit) <= min(strength, 1.0 / strength) * (1 + 1e-9)
    assert 0.1 <= strength / limit <= 10.0


USUAL_RAD = np.array([0.1, 0.01])


def error(times: float) -> tuple[np.ndarray, np.ndarray]:
    """Return errors of an RMS in units of their standard deviations, and these."""
    drawn = np.random.default_rng(1).normal(size=(500, 2))
    std = np.tile(USUAL_RAD, (500, 1))
    return times * drawn / np.sqrt(np.mean(drawn**2)) * std, std


def changed(together: float, alone: float, *, surprise: float = 2.0) -> bool:
    """Return the answer for residuals of fits to all trials and to the new one, beside the usual ones."""
    return arm_has_changed(*error(surprise), USUAL_RAD, lambda: (together * USUAL_RAD, alone * USUAL_RAD))


@pytest.mark.parametrize("times", [0.0, 1.0, 1.4])
def test_errors_as_they_are_expected_raise_no_question(times: float) -> None:
    def asked() -> tuple[np.ndarray, np.ndarray]:
        raise AssertionError("there was no doubt")

    assert not arm_has_changed(*error(times), USUAL_RAD, asked)


@pytest.mark.parametrize("surprise", [2.0, 1000.0])
def test_a_surprise_that_goes_together_with_earlier_trials_is_no_change(surprise: float) -> None:
    assert not changed(1.0, 1.0, surprise=surprise)
    assert not changed(1.9, 1.0, surprise=surprise)


@pytest.mark.parametrize("surprise", [2.0, 1000.0])
def test_a_surprise_that_earlier_trials_contradict_is_a_change(surprise: float) -> None:
    assert changed(4.0, 1.0, surprise=surprise)
    assert changed(4.0, 0.1, surprise=surprise)


def test_what_no_fit_explains_is_noise_and_no_change() -> None:
    assert not changed(10.0, 9.0, surprise=1000.0)


def test_a_fit_to_few_samples_that_leaves_less_than_usual_proves_nothing() -> None:
    assert not changed(1.5, 1e-6)


def test_where_nothing_is_known_nothing_surprises() -> None:
    wrong, _ = error(1e6)
    unknown = np.full(wrong.shape, np.inf)
    assert not arm_has_changed(wrong, unknown, USUAL_RAD, lambda: (1e6 * USUAL_RAD, USUAL_RAD))


@pytest.mark.filterwarnings("error")
def test_a_fit_without_any_residual_is_a_number_all_the_same() -> None:
    none = np.zeros(2)
    assert not arm_has_changed(*error(9.0), none, lambda: (none, none))
