"""The sequence of movements that practice goes through."""

from __future__ import annotations

import numpy as np
import pytest

from tel_ros.core.config import PracticeConfig
from tel_ros.core.control.records import Outcome, TrialReport
from tel_ros.core.practice.strategy import PlannedTrial, Strategy, make_strategy


def report(outcome: Outcome) -> TrialReport:
    return TrialReport(
        index=1,
        alpha=0.5,
        duration_s=9.0,
        outcome=outcome,
        message="",
        start_ns=0,
        run_ns=0,
        end_ns=0,
        ticks=0,
        rms_error_rad=0.1,
        rms_error_per_joint_rad=np.zeros(2),
        max_error_rad=0.1,
        max_effort_nm=np.zeros(2),
        saturated_ratio=0.0,
    )


def practise(strategy: Strategy, outcome: Outcome = Outcome.COMPLETED) -> list[PlannedTrial]:
    """Return the trials of a run in which each trial ends alike."""
    planned: list[PlannedTrial] = []
    last: TrialReport | None = None
    while (plan := strategy.next(last)) is not None:
        planned.append(plan)
        assert len(planned) <= 100, "practice does not end"
        last = report(outcome)
    return planned


def test_the_papers_schedule_is_fifteen_trials_in_steps_of_half_a_second() -> None:
    planned = practise(make_strategy(PracticeConfig()))
    assert [plan.duration_s for plan in planned] == [11.5 - 0.5 * k for k in range(15)]
    assert [plan.index for plan in planned] == list(range(1, 16))


def test_alpha_is_the_speed_as_a_share_of_the_goal_speed() -> None:
    planned = practise(make_strategy(PracticeConfig()))
    assert planned[0].alpha == pytest.approx(4.5 / 11.5)
    assert planned[-1].alpha == 1.0


@pytest.mark.parametrize(("spacing", "power"), [("duration", 1), ("speed", -1), ("torque", -2)])
@pytest.mark.parametrize("trials", [2, 7, 15])
def test_each_spacing_goes_up_in_even_steps_of_its_own_from_first_to_goal(
    spacing: str, power: int, trials: int
) -> None:
    config = PracticeConfig(spacing=spacing, trials=trials, first_duration_s=11.3, goal_duration_s=3.7)
    durations = [plan.duration_s for plan in practise(make_strategy(config))]
    assert len(durations) == trials
    assert durations[0] == pytest.approx(11.3, rel=1e-12)
    assert durations[-1] == 3.7, "the last trial is the one that was asked for, to the last bit"
    assert np.all(np.diff(durations) < 0.0)
    steps = np.diff(np.power(durations, float(power)))
    np.testing.assert_allclose(steps, steps[0], rtol=1e-9)  # rounding


def test_a_single_trial_is_at_the_goal_speed() -> None:
    assert practise(make_strategy(PracticeConfig(trials=1))) == [PlannedTrial(1, 1.0, 4.5)]


@pytest.mark.parametrize("spacing", ["duration", "torque"])
def test_direct_runs_every_trial_at_the_goal_speed(spacing: str) -> None:
    planned = practise(make_strategy(PracticeConfig(strategy="direct", trials=4, spacing=spacing)))
    assert planned == [PlannedTrial(k, 1.0, 4.5) for k in (1, 2, 3, 4)]


@pytest.mark.parametrize("strategy", ["trajectory_extension", "direct"])
def test_what_is_planned_is_what_comes_if_nothing_goes_wrong(strategy: str) -> None:
    made = make_strategy(PracticeConfig(strategy=strategy, trials=5))
    before = made.planned_durations_s.copy()
    assert [plan.duration_s for plan in practise(made)] == before.tolist()
    np.testing.assert_array_equal(made.planned_durations_s, before)


@pytest.mark.parametrize("strategy", ["trajectory_extension", "direct"])
def test_an_aborted_trial_ends_the_run(strategy: str) -> None:
    made = make_strategy(PracticeConfig(strategy=strategy, on_abort="stop"))
    assert len(practise(made, Outcome.ABORTED)) == 1


@pytest.mark.parametrize("strategy", ["trajectory_extension", "direct"])
def test_an_aborted_trial_does_not_end_a_run_that_is_to_go_on(strategy: str) -> None:
    made = make_strategy(PracticeConfig(strategy=strategy, on_abort="continue"))
    assert len(practise(made, Outcome.ABORTED)) == 15


@pytest.mark.parametrize("on_abort", ["stop", "continue"])
def test_a_cancelled_trial_ends_the_run(on_abort: str) -> None:
    assert len(practise(make_strategy(PracticeConfig(on_abort=on_abort)), Outcome.CANCELLED)) == 1


def test_an_abort_later_in_the_run_ends_it_there() -> None:
    made = make_strategy(PracticeConfig())
    made.next(None)
    assert made.next(report(Outcome.COMPLETED)).index == 2
    assert made.next(report(Outcome.ABORTED)) is None
