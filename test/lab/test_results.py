"""What counts as having learned the movement, medians that may be "never", and fair rankings."""

from __future__ import annotations

import math

import pytest

from tel_lab.comparison.results import COLUMNS, MethodRun, TrialResult
from tel_lab.comparison.statistics import is_worse, median, standing


def trial(
    duration_s: float, rms_rad: float, *, completed: bool = True, largest_rad: float = 0.1
) -> TrialResult:
    return TrialResult(duration_s, completed, rms_rad, largest_rad, arm_s=duration_s + 2.0)


def run(
    *trials: TrialResult, new_path: TrialResult | None = None, final: TrialResult | None = None
) -> MethodRun:
    return MethodRun("method", 1, 4.5, 5e-3, trials, final or trial(4.5, 1e-3), new_path, 1.5, cpu_s=1.0)


def test_only_completed_trials_at_the_goal_speed_count_as_learned() -> None:
    slow, aborted = trial(6.0, 1e-3), trial(4.5, 1e-3, completed=False)
    found = run(slow, aborted, trial(4.5, 6e-3), trial(4.5, 5e-3), trial(4.5, 1e-3))
    assert found.trials_to_tolerance == 4
    assert found.arm_s_to_tolerance == 8.0 + 3 * 6.5


def test_a_movement_that_was_not_learned_took_for_ever() -> None:
    found = run(trial(4.5, 6e-3))
    assert found.trials_to_tolerance == found.arm_s_to_tolerance == math.inf


def test_the_largest_deviation_is_that_of_the_worst_trial_even_if_it_was_aborted() -> None:
    worst = trial(4.5, 0.3, completed=False, largest_rad=1.1)
    unmoved = trial(4.5, math.nan, completed=False, largest_rad=math.nan)
    assert run(trial(4.5, 0.1), worst, unmoved, trial(4.5, 0.1)).largest_deviation_rad == 1.1
    assert run(worst, unmoved).aborts == 2


def test_a_test_that_was_aborted_has_an_infinite_error_and_one_that_cannot_be_made_has_none() -> None:
    aborted = trial(4.5, 0.01, completed=False)
    assert run(trial(4.5, 0.1), final=aborted).final_error_rad == math.inf
    assert run(trial(4.5, 0.1), new_path=aborted).new_path_error_rad == math.inf
    assert math.isnan(run(trial(4.5, 0.1)).new_path_error_rad)


def test_the_arm_is_busy_in_tests_too() -> None:
    assert run(trial(4.5, 0.1), new_path=trial(3.0, 0.1)).arm_s == 6.5 + 6.5 + 5.0


def test_a_movement_is_as_many_times_as_long_as_the_arm_could_do_it_in() -> None:
    assert run(trial(4.5, 0.1)).time_over_bound == 3.0
    assert run(trial(4.5, 0.1), final=trial(4.5, 0.1, completed=False)).time_over_bound == math.inf


def test_columns_have_keys_of_their_own() -> None:
    assert len({column.key for column in COLUMNS}) == len(COLUMNS) == 7


def test_the_interval_of_ten_values_lies_between_the_second_and_the_ninth() -> None:
    """Binomial: P(2 to 8 of 10 values are below the median) = 0.979, and 0.891 for 3 to 7."""
    found = median([10.0, 3.0, 1.0, 7.0, 5.0, 2.0, 9.0, 4.0, 8.0, 6.0])
    assert (found.value, found.low, found.high) == (5.5, 2.0, 9.0)


def test_values_that_are_never_reached_count_as_the_largest() -> None:
    found = median([1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, math.inf, math.inf, math.inf])
    assert (found.value, found.high) == (5.5, math.inf)
    assert median([math.inf] * 4).value == math.inf


def test_few_values_have_a_median_but_no_interval() -> None:
    found = median([2.0, 1.0, 3.0])
    assert found.value == 2.0
    assert math.isnan(found.low) and math.isnan(found.high)


@pytest.mark.parametrize(
    ("n_larger", "worse"),
    [(8, False), (9, True), (10, True)],  # P(at least 8 of 10) = 0.055, P(at least 9) = 0.011
)
def test_worse_means_worse_on_nearly_all_arms(n_larger: int, worse: bool) -> None:
    one = [2.0] * n_larger + [0.0] * (10 - n_larger)
    assert is_worse(one, [1.0] * 10) is worse


def test_equal_values_tell_nothing_about_which_is_worse() -> None:
    assert not is_worse([math.inf] * 10, [math.inf] * 10)
    assert not is_worse([2.0] + [1.0] * 9, [1.0] * 10)


def test_standings() -> None:
    values = {
        "good": [1.0 + 0.01 * k for k in range(10)],
        "equal": [1.0 + 0.01 * k for k in range(10)],
        "as good": [0.9, 0.9, 0.9, 0.9, 0.9, 0.9, 2.0, 2.0, 2.0, 2.0],
        "bad": [3.0] * 9 + [math.inf],
    }
    assert standing("as good", values).rank == "first"
    assert standing("good", {name: values[name] for name in ("good", "equal", "bad")}).rank == "first"
    tied = standing("good", values)
    assert (tied.rank, tied.rivals) == ("tied", ("as good",))
    behind = standing("bad", values)
    assert behind.rank == "behind"
    assert set(behind.rivals) == {"good", "equal", "as good"}
    assert behind.rivals[0] == "as good"  # the lowest median
