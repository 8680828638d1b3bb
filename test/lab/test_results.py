"""What counts as having learned the movement, and what could have hurt on the way."""

from __future__ import annotations

import math

from tel_lab.comparison.results import COLUMNS, MethodRun, TrialResult


def trial(
    duration_s: float, rms_rad: float, *, completed: bool = True, largest_rad: float = 0.1
) -> TrialResult:
    return TrialResult(duration_s, completed, rms_rad, largest_rad, arm_s=duration_s + 2.0)


def run(
    *trials: TrialResult, new_path: TrialResult | None = None, final: TrialResult | None = None
) -> MethodRun:
    return MethodRun("method", 1, 4.5, 5e-3, trials, final or trial(4.5, 1e-3), new_path, cpu_s=1.0)


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


def test_columns_have_keys_of_their_own() -> None:
    assert len({column.key for column in COLUMNS}) == len(COLUMNS) == 6
