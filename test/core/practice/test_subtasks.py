"""The known movement, then the parts, then the whole."""

from __future__ import annotations

import math

import numpy as np
import pytest
from made_up_arm import MadeUpArm, config_of, practise, report_of

from tel_ros.core.config import PracticeConfig
from tel_ros.core.errors import counted
from tel_ros.core.practice.course import Course
from tel_ros.core.practice.movement_path import desired_trajectory
from tel_ros.core.practice.strategies import Subtasks, make_strategy
from tel_ros.core.practice.strategy import Ending, Forecast, Movement, PlannedTrial
from tel_ros.core.trajectories.paths import NAMED_PATHS
from tel_ros.core.trial import Outcome, TrialReport
from tel_ros.core.types import FloatArray


def easy(**values: float) -> MadeUpArm:
    """Return an arm on which every step comes out well."""
    return MadeUpArm(**({"growth_rad": 0.02} | values))  # type: ignore[arg-type]


def subtasks(**practice: object) -> Subtasks:
    strategy = make_strategy(config_of(**({"strategy": "subtasks", "trials": 60} | practice)))
    assert isinstance(strategy, Subtasks)
    return strategy


def stretch(plan: PlannedTrial) -> tuple[float, float]:
    return plan.movement.start, plan.movement.end


def test_first_the_whole_slowly_then_each_part_up_to_the_goal_speed_then_the_whole() -> None:
    plans, reports, ending = practise(subtasks(parts=3), easy())
    assert ending.outcome == "completed"
    stretches = list(dict.fromkeys(stretch(plan) for plan in plans))
    assert stretches[0] == (0.0, 1.0)
    np.testing.assert_allclose(stretches[1:], [(0, 1 / 3), (1 / 3, 2 / 3), (2 / 3, 1)], atol=1e-12)
    for part in stretches[1:]:
        durations_s = [plan.movement.duration_s for plan in plans if stretch(plan) == part]
        assert durations_s[0] == 11.5
        assert durations_s[-1] == pytest.approx(4.5, rel=0.01)
        assert durations_s == sorted(durations_s, reverse=True)
    first, last = plans[0].movement, plans[-1].movement
    assert first == Movement(11.5)
    assert last == Movement(4.5)
    assert reports[-1].rms_error_rad <= 5e-3
    whole = [plan.movement.duration_s for plan in plans if stretch(plan) == (0.0, 1.0)]
    assert set(whole) == {11.5, 4.5}, "between them the whole is not practised"


def test_trials_are_numbered_through() -> None:
    plans, _, _ = practise(subtasks(), easy())
    assert [plan.index for plan in plans] == list(range(1, len(plans) + 1))


def test_parts_need_the_tolerance_of_a_step_and_the_whole_that_of_the_goal() -> None:
    """On an arm that always errs by 10 mrad, the parts are good enough, the whole never is."""
    arm = MadeUpArm(growth_rad=0.0, floor_rad=0.01)
    plans, _, ending = practise(subtasks(), arm)
    assert ending.outcome == "stopped"
    assert ending.message.startswith("the whole: 4.5 s within 5.00 mrad was not reached")
    assert plans[-1].movement == Movement(4.5)


def test_a_part_that_cannot_be_learned_ends_practice_and_is_named() -> None:
    unlearnable = MadeUpArm(growth_rad=0.0, floor_rad=0.03)
    plans, _, ending = practise(subtasks(), easy(), changes={3: unlearnable})
    assert (plans[1].movement, stretch(plans[2])) == (Movement(11.5), (0.0, 0.25))
    assert ending.outcome == "stopped"
    assert ending.message.startswith("part 1 of 4: 4.5 s, from 0 to 0.25 of the path within 20.00 mrad")


def test_a_part_that_is_beyond_the_effort_limits_ends_practice() -> None:
    arm = easy(peak_nms2=500.0)
    plans, _, ending = practise(subtasks(), arm)
    assert ending.outcome == "stopped"
    assert "part 1 of 4" in ending.message
    assert "would need 24.7 N·m" in ending.message
    assert plans[-1].movement.duration_s > 4.6


def test_alpha_is_the_share_of_the_path_times_that_of_the_speed() -> None:
    plans, _, _ = practise(subtasks(parts=2), easy())
    assert plans[0].alpha == pytest.approx(4.5 / 11.5)
    for plan in plans:
        length = plan.movement.end - plan.movement.start
        assert plan.alpha == pytest.approx(length * 4.5 / plan.movement.duration_s)
    assert plans[-1].alpha == 1.0


def test_the_number_of_trials_is_that_of_all_together() -> None:
    for trials in range(1, 12):
        plans, _, ending = practise(subtasks(trials=trials), easy())
        assert len(plans) == trials
        assert ending.outcome == "stopped"
        assert counted(trials, "trial") in ending.message


def test_an_abort_at_the_beginning_of_a_part_goes_back_to_the_network_from_before_it() -> None:
    strategy, known = subtasks(), easy()
    last: TrialReport | None = None
    while True:
        plan = strategy.next(last, known.forecast)
        assert isinstance(plan, PlannedTrial)
        if stretch(plan) == (0.25, 0.5):
            break
        last = known.execute(plan)
    again = strategy.next(report_of(plan, Outcome.ABORTED), known.forecast)
    assert isinstance(again, PlannedTrial)
    assert stretch(again) == (0.25, 0.5)
    assert again.go_back_to == plan.index - 1
    assert again.index == plan.index + 1
    assert again.movement.duration_s >= plan.movement.duration_s * math.sqrt(2.0)


def test_an_abort_of_the_whole_at_the_goal_speed_tries_it_slower() -> None:
    strategy, arm = subtasks(), easy()
    last: TrialReport | None = None
    while True:
        plan = strategy.next(last, arm.forecast)
        assert isinstance(plan, PlannedTrial)
        if plan.movement == Movement(4.5):
            break
        last = arm.execute(plan)
    again = strategy.next(report_of(plan, Outcome.ABORTED), arm.forecast)
    assert isinstance(again, PlannedTrial)
    assert again.movement == Movement(11.5), "as slow as is known to be safe"
    assert again.go_back_to == plan.index - 1


def test_cancelling_ends_practice() -> None:
    strategy = subtasks()

    def forecast(movement: Movement) -> Forecast:
        return Forecast(np.full((5, 2), math.inf), np.zeros((5, 2)), np.zeros((5, 2)), movement.duration_s)

    plan = strategy.next(None, forecast)
    assert isinstance(plan, PlannedTrial)
    ending = strategy.next(report_of(plan, Outcome.CANCELLED), forecast)
    assert isinstance(ending, Ending)
    assert ending.outcome == "cancelled"


def test_the_outlook_has_all_stages_and_shrinks() -> None:
    strategy, arm = subtasks(parts=2), easy()
    stretches = [(0.0, 1.0), (0.0, 0.5), (0.5, 1.0)]
    preview = strategy.preview()
    assert list(dict.fromkeys((m.start, m.end) for m in preview)) == stretches
    assert preview[0] == Movement(11.5)
    assert preview[-1] == Movement(4.5)
    for start, end in stretches[1:]:
        assert Movement(4.5, start=start, end=end) in preview
    n = len(preview)
    plan = strategy.next(None, arm.forecast)
    assert isinstance(plan, PlannedTrial)
    assert len(strategy.preview()) == n - 1


def test_parts_and_the_known_path_go_further_than_the_goal_alone() -> None:
    """With input ranges of the goal alone, a learner would not see how its parts start and stop."""
    config = config_of(strategy="subtasks", parts=4)
    path = NAMED_PATHS["planar_loops"]

    def peak_rad_s2(movement: Movement) -> FloatArray:
        desired = desired_trajectory(path, None, movement, 500.0)
        peak: FloatArray = np.abs(desired.acceleration_rad_s2).max(axis=0)
        return peak

    goal, *parts = make_strategy(config).movements_to_cover()
    assert goal == Movement(4.5)
    assert [(part.start, part.end) for part in parts] == [(0, 0.25), (0.25, 0.5), (0.5, 0.75), (0.75, 1)]
    assert np.any(np.max([peak_rad_s2(part) for part in parts], axis=0) > 1.3 * peak_rad_s2(goal))
    varied = make_strategy(config_of(vary=("amplitude", "speed", "stiffness")))
    assert varied.movements_to_cover() == [goal]
    shape = Course.configured(PracticeConfig(vary=("shape",)))
    assert shape.to_cover == [goal, Movement(4.5, shape=0.0)]
