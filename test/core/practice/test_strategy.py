"""Strategies that know their movements beforehand."""

from __future__ import annotations

import numpy as np
import pytest
from made_up_arm import config_of, report_of

from tel_ros.core.practice.strategies import make_strategy
from tel_ros.core.practice.strategy import Ending, Forecast, Movement, PlannedTrial, Strategy
from tel_ros.core.trial import Outcome, TrialReport

SCHEDULES = ["trajectory_extension", "direct"]


def no_forecast(movement: Movement) -> Forecast:
    """Fail: a schedule needs no forecast."""
    raise AssertionError("a forecast was asked for")


def practise(strategy: Strategy, outcome: Outcome = Outcome.COMPLETED) -> tuple[list[PlannedTrial], Ending]:
    """Return the trials of a run in which each trial ends alike, and how the run ends."""
    planned: list[PlannedTrial] = []
    last: TrialReport | None = None
    while isinstance(decision := strategy.next(last, no_forecast), PlannedTrial):
        planned.append(decision)
        assert len(planned) <= 100, "practice does not end"
        last = report_of(decision, outcome)
    return planned, decision


def durations(**practice: object) -> list[float]:
    """Return the durations of a run in which nothing goes wrong."""
    return [plan.movement.duration_s for plan in practise(make_strategy(config_of(**practice)))[0]]


def test_the_papers_schedule_is_fifteen_trials_in_steps_of_half_a_second() -> None:
    planned, ending = practise(make_strategy(config_of()))
    assert [plan.movement.duration_s for plan in planned] == [11.5 - 0.5 * k for k in range(15)]
    assert [plan.index for plan in planned] == list(range(1, 16))
    assert ending == Ending("completed")


def test_alpha_is_the_speed_as_a_share_of_the_goal_speed() -> None:
    planned, _ = practise(make_strategy(config_of()))
    assert planned[0].alpha == pytest.approx(4.5 / 11.5)
    assert planned[-1].alpha == 1.0


@pytest.mark.parametrize(("spacing", "power"), [("duration", 1), ("speed", -1), ("torque", -2)])
@pytest.mark.parametrize("trials", [2, 7, 15])
def test_each_spacing_goes_up_in_even_steps_of_its_own_from_first_to_goal(
    spacing: str, power: int, trials: int
) -> None:
    found = durations(spacing=spacing, trials=trials, first_duration_s=11.3, goal_duration_s=3.7)
    assert len(found) == trials
    assert found[0] == pytest.approx(11.3, rel=1e-12)
    assert found[-1] == 3.7, "the last trial is the one that was asked for, to the last bit"
    assert np.all(np.diff(found) < 0.0)
    steps = np.diff(np.power(found, float(power)))
    np.testing.assert_allclose(steps, steps[0], rtol=1e-9)  # rounding


def test_a_list_of_durations_is_followed_as_it_is() -> None:
    listed = (11.5, 9.0, 7.0, 5.5, 4.5, 4.5)
    assert durations(durations_s=listed, trials=3) == list(listed)


def test_a_single_trial_is_at_the_goal_speed() -> None:
    assert durations(trials=1) == [4.5]


@pytest.mark.parametrize("spacing", ["duration", "torque"])
def test_direct_runs_every_trial_at_the_goal_speed(spacing: str) -> None:
    planned, _ = practise(make_strategy(config_of(strategy="direct", trials=4, spacing=spacing)))
    assert [(plan.index, plan.alpha, plan.movement) for plan in planned] == [
        (k, 1.0, Movement(4.5)) for k in (1, 2, 3, 4)
    ]


@pytest.mark.parametrize("strategy", SCHEDULES)
def test_the_outlook_is_what_comes(strategy: str) -> None:
    made = make_strategy(config_of(strategy=strategy, trials=5))
    before = list(made.preview())
    first = made.next(None, no_forecast)
    assert isinstance(first, PlannedTrial)
    assert [first.movement, *made.preview()] == before
    assert [
        plan.movement for plan in practise(make_strategy(config_of(strategy=strategy, trials=5)))[0]
    ] == before


@pytest.mark.parametrize("strategy", SCHEDULES)
def test_an_aborted_trial_ends_the_run(strategy: str) -> None:
    planned, ending = practise(make_strategy(config_of(strategy=strategy, on_abort="stop")), Outcome.ABORTED)
    assert len(planned) == 1
    assert ending == Ending("aborted", "trial 1 was aborted: elbow is off")


@pytest.mark.parametrize("strategy", SCHEDULES)
def test_an_aborted_trial_does_not_end_a_run_that_is_to_go_on_before_its_last_one(strategy: str) -> None:
    made = make_strategy(config_of(strategy=strategy, on_abort="continue"))
    planned, ending = practise(made, Outcome.ABORTED)
    assert len(planned) == 15
    assert ending.outcome == "aborted"


@pytest.mark.parametrize("strategy", [*SCHEDULES, "adaptive_extension"])
@pytest.mark.parametrize("on_abort", ["stop", "continue"])
def test_a_cancelled_trial_ends_the_run(strategy: str, on_abort: str) -> None:
    made = make_strategy(config_of(strategy=strategy, on_abort=on_abort))
    nothing, unknown = np.zeros((2, 2)), np.full((2, 2), np.inf)
    first = made.next(None, lambda movement: Forecast(unknown, nothing, nothing, movement.duration_s))
    assert isinstance(first, PlannedTrial)
    assert made.next(report_of(first, Outcome.CANCELLED), no_forecast) == Ending(
        "cancelled", "the run was cancelled"
    )
