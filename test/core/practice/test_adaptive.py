"""Practice that chooses its own steps, on an arm that is nothing but a formula for errors."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from made_up_arm import MadeUpArm, config_of, practise

from tel_ros.core.practice.strategies import make_strategy
from tel_ros.core.practice.strategy import PlannedTrial, Strategy
from tel_ros.core.trial import Outcome, TrialReport, shortfall


def adaptive(path_tolerance_rad: float = 1.0, **practice: object) -> Strategy:
    return make_strategy(config_of(path_tolerance_rad, strategy="adaptive_extension", **practice))


def durations(plans: list[PlannedTrial]) -> np.ndarray:
    return np.array([plan.movement.duration_s for plan in plans])


def test_it_ends_at_the_goal_within_the_tolerance() -> None:
    plans, reports, ending = practise(adaptive(), MadeUpArm())
    assert ending.outcome == "completed"
    assert plans[-1].movement.duration_s == 4.5 and plans[-1].alpha == 1.0
    assert reports[-1].rms_error_rad <= 5e-3
    assert "4.5 s reached" in ending.message and f"after {len(plans)} trials" in ending.message


def test_it_starts_at_the_first_duration_and_never_slows_down_while_all_goes_well() -> None:
    plans, _, _ = practise(adaptive(first_duration_s=9.0), MadeUpArm())
    assert plans[0].movement.duration_s == 9.0
    assert np.all(np.diff(durations(plans)) <= 0.0)


def test_no_step_has_an_expected_error_above_the_tolerance_of_a_step() -> None:
    plans, _, _ = practise(adaptive(step_tolerance_rad=0.012, trials=40), MadeUpArm(growth_rad=0.2))
    steps = [plan for plan, faster in zip(plans[1:], np.diff(durations(plans)) < 0.0, strict=True) if faster]
    assert len(steps) > 5, "the steps are too large to say anything"
    assert all(plan.expected_rms_rad <= 0.012 for plan in steps)


def test_the_better_the_learner_extrapolates_the_fewer_the_trials() -> None:
    n_trials = [
        len(practise(adaptive(trials=60), MadeUpArm(growth_rad=growth))[0]) for growth in (0.02, 0.1, 0.4)
    ]
    assert n_trials[0] < n_trials[1] < n_trials[2]


def test_a_learner_that_promises_too_much_is_believed_less_and_less() -> None:
    boasting, reports, ending = practise(adaptive(trials=60), MadeUpArm(growth_rad=0.2, frankness=0.1))
    assert ending.outcome == "completed"
    errors = [report.rms_error_rad for report in reports]
    # One surprise, then its standard deviation is multiplied by what it was short of.
    surprises = [
        e for e, plan in zip(errors[1:], boasting[1:], strict=True) if e > 2.0 * plan.expected_rms_rad
    ]
    assert 1 <= len(surprises) <= 2


def test_a_step_that_came_out_worse_is_repeated() -> None:
    plans, reports, _ = practise(adaptive(trials=60), MadeUpArm(growth_rad=0.2, frankness=0.1))
    worse = [k for k, report in enumerate(reports[:-1]) if k and report.rms_error_rad > 0.02]
    assert worse, "nothing came out worse"
    for k in worse:
        assert plans[k + 1].movement == plans[k].movement
        assert "repeated" in plans[k + 1].reason


def test_the_goal_is_repeated_until_its_own_tolerance_is_kept() -> None:
    plans, reports, ending = practise(adaptive(), MadeUpArm(growth_rad=0.03))
    at_goal = [report.rms_error_rad for report in reports if report.duration_s == 4.5]
    assert ending.outcome == "completed"
    assert all(error > 5e-3 for error in at_goal[:-1]) and at_goal[-1] <= 5e-3


@pytest.mark.parametrize("static_nm", [0.0, 5.0])
def test_it_stops_at_the_fastest_speed_that_the_effort_limits_allow_and_says_so(static_nm: float) -> None:
    # The limit of the arm is 20 N·m; 97 % of it are used.
    arm = MadeUpArm(peak_nms2=600.0, static_nm=static_nm)
    fastest_s = math.sqrt(600.0 / (0.97 * 20.0 - static_nm))
    plans, reports, ending = practise(adaptive(trials=40), arm)
    assert ending.outcome == "stopped"
    assert durations(plans).min() == pytest.approx(fastest_s, rel=0.02)
    assert durations(plans).min() >= 0.999 * fastest_s, "it tried what cannot be"
    assert "4.5 s cannot be reached" in ending.message and "(limit 20 N·m)" in ending.message
    assert f"{600.0 / 4.5**2 + static_nm:.1f} N·m" in ending.message
    assert reports[-1].rms_error_rad <= 5e-3


def test_it_plans_with_what_a_drive_has_given_where_that_is_less_than_its_limit(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    arm, execute = MadeUpArm(peak_nms2=400.0), MadeUpArm.execute

    def limited(self: MadeUpArm, plan: PlannedTrial) -> TrialReport:
        needed_nm = 400.0 / plan.movement.duration_s**2
        message = shortfall("shoulder", 8.0, needed_nm) if needed_nm > 8.0 else ""
        return replace(execute(self, plan), message=message)

    monkeypatch.setattr(MadeUpArm, "execute", limited)
    plans, _, ending = practise(adaptive(trials=40), arm)
    assert ending.outcome == "stopped"
    assert durations(plans)[-1] == pytest.approx(math.sqrt(400.0 / (0.97 * 8.0)), rel=0.02)
    assert "4.5 s cannot be reached" in ending.message and "(limit 8 N·m)" in ending.message


def test_effort_is_no_limit_where_the_goal_needs_less() -> None:
    assert practise(adaptive(), MadeUpArm(peak_nms2=0.96 * 20.0 * 4.5**2))[2].outcome == "completed"


def changed_arm(**values: float) -> MadeUpArm:
    return MadeUpArm(growth_rad=0.05, unlearned_rad=0.09, **values)


def test_after_an_abort_it_goes_back_to_the_network_and_at_least_to_the_duration_of_the_last_good_trial() -> (
    None
):
    plans, reports, ending = practise(adaptive(trials=40), MadeUpArm(), changes={3: changed_arm()})
    aborted = [k for k, report in enumerate(reports) if report.outcome == Outcome.ABORTED]
    assert aborted == [2]
    assert plans[3].go_back_to == 2
    assert plans[3].movement.duration_s >= max(
        plans[1].movement.duration_s, math.sqrt(2.0) * plans[2].movement.duration_s
    )
    assert "back after the abort of trial 3" in plans[3].reason
    assert math.isnan(plans[3].expected_rms_rad)
    assert ending.outcome == "completed"


def test_the_first_step_after_an_abort_is_at_most_half_of_the_one_that_failed() -> None:
    plans, _, _ = practise(adaptive(trials=40), MadeUpArm(growth_rad=0.01), changes={3: changed_arm()})
    t = durations(plans)
    failed_step = math.log(t[1] / t[2])
    again = next(k for k in range(4, len(t)) if t[k] < t[k - 1])
    assert math.log(t[again - 1] / t[again]) <= 0.5 * failed_step + 1e-9


@pytest.mark.parametrize("when", [3, 4, 5])
@pytest.mark.parametrize("abort_rad", [0.1, 0.2, 0.3])
def test_an_arm_that_has_changed_is_not_driven_beyond_its_tolerance_twice_in_a_row(
    when: int, abort_rad: float
) -> None:
    # The path tolerance at which the made-up arm aborts is three times its RMS error.
    strategy = adaptive(path_tolerance_rad=3.0 * abort_rad, trials=60)
    _, reports, ending = practise(
        strategy,
        MadeUpArm(growth_rad=0.1, abort_rad=abort_rad),
        changes={when: changed_arm(abort_rad=abort_rad)},
    )
    outcomes = [report.outcome for report in reports]
    pairs = zip(outcomes, outcomes[1:], strict=False)
    assert (Outcome.ABORTED, Outcome.ABORTED) not in list(pairs)
    assert ending.outcome == "completed"


def test_a_first_trial_that_is_aborted_is_tried_again_more_slowly_with_nothing_learned() -> None:
    plans, reports, ending = practise(adaptive(trials=40), MadeUpArm(unlearned_rad=0.6))
    assert reports[0].outcome == Outcome.ABORTED
    assert plans[1].go_back_to == 0
    assert plans[1].movement.duration_s >= math.sqrt(2.0) * plans[0].movement.duration_s
    assert ending.outcome == "completed"


def test_it_gives_up_when_errors_do_not_fall_any_more_and_says_so() -> None:
    plans, _, ending = practise(adaptive(trials=40), MadeUpArm(floor_rad=0.03))
    assert ending.outcome == "stopped"
    assert "the error stays at 30.00 mrad RMS" in ending.message
    assert len(plans) < 10


def test_it_ends_after_the_most_trials_and_says_how_far_it_came() -> None:
    plans, reports, ending = practise(adaptive(trials=4), MadeUpArm(growth_rad=0.4))
    assert len(plans) == 4
    assert ending.outcome == "stopped"
    assert "within 4 trials" in ending.message and f"{reports[-1].duration_s:.3f} s" in ending.message


def test_the_outlook_leads_to_the_goal_and_is_empty_there() -> None:
    strategy = adaptive()
    first = [movement.duration_s for movement in strategy.preview()]
    assert first[0] == 11.5 and first[-1] == 4.5 and first == sorted(first, reverse=True)
    practise(strategy, MadeUpArm())
    assert list(strategy.preview()) == []


@pytest.mark.parametrize("strategy", ["adaptive_extension", "subtasks"])
def test_the_outlook_has_no_more_than_the_trials_that_are_left_once_practice_has_begun(strategy: str) -> None:
    made, arm = make_strategy(config_of(strategy=strategy, trials=3)), MadeUpArm(growth_rad=0.4)
    assert made.preview()[-1].duration_s == 4.5, "what is checked before anything moves has the goal"
    left, last = [], None
    while isinstance(plan := made.next(last, arm.forecast), PlannedTrial):
        left.append(len(made.preview()))
        last = arm.execute(plan)
    assert left == [2, 1, 0]


def test_a_network_from_an_earlier_run_that_does_not_fit_is_not_taken_for_an_unlearned_one() -> None:
    plans, reports, _ = practise(adaptive(), MadeUpArm(frankness=0.01, _known_s=[30.0]))
    assert reports[0].rms_error_rad > 0.02
    assert "repeated" in plans[1].reason and plans[1].movement == plans[0].movement


def test_a_run_that_ends_in_an_abort_says_why_instead_of_an_error_that_was_not_measured() -> None:
    _, reports, ending = practise(adaptive(trials=2), MadeUpArm(abort_rad=1e-3))
    assert ending.outcome == "aborted"
    assert ending.message.endswith(f"was aborted: {reports[-1].message}") and reports[-1].message
    assert "nan" not in ending.message
