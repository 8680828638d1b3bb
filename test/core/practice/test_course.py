"""The way from the first movement to the goal, with one thing that varies or several."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
import pytest
from made_up_arm import MadeUpArm, config_of, practise, report_of

from tel_ros.core.config import Config, ControlConfig, PathConfig, PracticeConfig
from tel_ros.core.errors import ConfigError
from tel_ros.core.practice.adaptive import AdaptiveExtension
from tel_ros.core.practice.course import Course, Leg
from tel_ros.core.practice.strategies import make_strategy
from tel_ros.core.practice.strategy import Ending, Forecast, Movement, PlannedTrial
from tel_ros.core.trial import Outcome

VARIED = ("speed", "amplitude", "shape", "stiffness")
ORDERS = [order for n in (1, 2, 4) for order in itertools.permutations(VARIED, n)]


def course_of(*vary: str, **practice: Any) -> Course:
    return Course.configured(PracticeConfig(vary=vary, **practice))  # type: ignore[arg-type]


def test_a_course_begins_with_all_first_values_and_ends_with_the_goal() -> None:
    for vary in ORDERS:
        course = course_of(*vary)
        first = {"duration_s": 4.5, "amplitude": 1.0, "shape": 1.0, "stiffness": 1.0}
        values = {
            "speed": {"duration_s": 11.5},
            "amplitude": {"amplitude": 0.3},
            "shape": {"shape": 0.0},
            "stiffness": {"stiffness": 4.0},
        }
        for varied in vary:
            first |= values[varied]
        assert course.movement(course.first_slowness) == Movement(**first)
        assert course.movement(course.goal_slowness) == course.goal == Movement(4.5)


def test_on_the_way_one_thing_changes_after_the_other_and_never_back() -> None:
    for vary in ORDERS:
        course = course_of(*vary)
        slownesses = np.geomspace(course.first_slowness, course.goal_slowness, 400)
        movements = [course.movement(float(slowness)) for slowness in slownesses]
        difficulty = np.array([(1 / m.duration_s, m.amplitude, m.shape, 1 / m.stiffness) for m in movements])
        steps = np.diff(difficulty, axis=0)
        assert np.all(steps >= -1e-12)
        changing = np.abs(steps) > 1e-12
        order = [VARIED[np.argmax(row)] for row in changing if np.count_nonzero(row) == 1]
        assert list(dict.fromkeys(order)) == list(vary)
        # Only the steps that lead from one to the other change two.
        assert np.count_nonzero(changing.sum(axis=1) > 1) <= len(vary) - 1
        alphas = [course.alpha(movement) for movement in movements]
        assert np.all(np.diff(alphas) >= -1e-12)
        assert alphas[-1] == 1.0


def test_if_only_the_speed_varies_the_slowness_is_the_duration_to_the_last_bit() -> None:
    course = course_of("speed")
    for duration_s in (30.0, 11.5, 7.1234567890123, 4.5):
        assert course.movement(duration_s) == Movement(duration_s)
        assert course.alpha(Movement(duration_s)) == 4.5 / duration_s


@pytest.mark.parametrize(
    ("varied", "first", "quarter"),
    [("speed", 8.0, 4.0), ("amplitude", 0.1, 0.4), ("stiffness", 8.0, 2.0)],
)
def test_half_the_slowness_means_four_times_the_deviation(varied: Any, first: float, quarter: float) -> None:
    """Torques go with 1/T² and with the amplitude, and what they do goes with 1/K."""
    leg = Leg(varied, first, 1.0)
    assert leg.value(leg.slowness(first) / 2.0) == pytest.approx(quarter, rel=1e-12)


def test_alpha_is_the_product_of_all_shares() -> None:
    movement = Movement(9.0, amplitude=0.5, shape=0.25, stiffness=2.0, start=0.5, end=1.0)
    assert course_of(*VARIED).alpha(movement) == pytest.approx(0.5 * 0.5 * 0.25 / 2.0 * 0.5)


@pytest.mark.parametrize(
    ("vary", "further"),
    [
        (("speed", "shape"), Movement(23.0, shape=0.0)),
        (("amplitude",), Movement(4.5, amplitude=0.075)),
        (("shape", "speed"), None),
        (("stiffness", "speed"), None),
    ],
)
def test_only_slower_and_smaller_movements_are_easier_than_the_first(
    vary: tuple[str, ...], further: Movement | None
) -> None:
    course = course_of(*vary)
    found = course.movement(2.0 * course.first_slowness)
    if further is None:
        assert found == course.movement(course.first_slowness)
        assert course.most_slowness == course.first_slowness
    else:
        assert found.duration_s == pytest.approx(further.duration_s)
        assert found.amplitude == pytest.approx(further.amplitude)
        assert math.isinf(course.most_slowness)


def test_the_movements_of_the_speed_leg_have_what_went_before_and_not_what_comes_after() -> None:
    course = course_of("amplitude", "speed", "stiffness")
    assert course.at_duration(7.0) == Movement(7.0, stiffness=4.0)
    assert course.movement(course.slowness_at_duration(7.0)).duration_s == pytest.approx(7.0, rel=1e-12)
    assert course.varies_speed_at(course.slowness_at_duration(7.0))
    assert not course.varies_speed_at(course.first_slowness)
    assert not course.varies_speed_at(course.goal_slowness)


def forecast_of_a_good_learner(movement: Movement) -> Forecast:
    """Expect small errors of everything, and an effort of 100 N·m·s² / T² at the full amplitude."""
    effort = np.full((10, 2), 100.0 * movement.amplitude / movement.duration_s**2)
    return Forecast(np.full((10, 2), 1e-3), effort, np.zeros((10, 2)), movement.duration_s)


def run(vary: tuple[str, ...], **practice: Any) -> tuple[list[PlannedTrial], Ending]:
    """Practise on an arm that always comes out within all tolerances."""
    strategy = AdaptiveExtension(config_of(vary=vary, **practice))
    plans, last = [], None
    while isinstance(decision := strategy.next(last, forecast_of_a_good_learner), PlannedTrial):
        plans.append(decision)
        assert len(plans) < 50
        last = report_of(decision, rms_error_rad=2e-3, max_error_rad=5e-3)
    return plans, decision


def test_practice_that_chooses_its_steps_gets_along_any_course() -> None:
    for vary in ORDERS:
        # 100 N·m·s² / T² stay below the limit of 20 N·m at the goal.
        plans, ending = run(vary)
        assert ending.outcome == "completed"
        course = course_of(*vary)
        assert plans[0].movement == course.movement(course.first_slowness)
        alphas = [plan.alpha for plan in plans]
        assert alphas == sorted(alphas)
        assert alphas[-1] == pytest.approx(1.0, abs=0.02)
        assert "4.5 s" in ending.message
        for varied in set(vary) - {"speed"}:
            assert varied in ending.message


def test_the_effort_limit_is_looked_for_along_the_speed_with_the_amplitude_of_that_leg() -> None:
    plans, ending = run(("amplitude", "speed"), goal_duration_s=2.0)
    assert ending.outcome == "stopped"
    # 0.97 of 20 N·m are needed at sqrt(100 / 19.4) s.
    assert plans[-1].movement.duration_s == pytest.approx(math.sqrt(100.0 / 19.4), rel=0.011)
    assert plans[-1].movement.amplitude == 1.0
    assert "would need 25.0 N·m" in ending.message


def test_where_there_is_nothing_easier_an_abort_of_the_first_trial_ends_practice() -> None:
    strategy = AdaptiveExtension(config_of(vary=("stiffness",)))
    plan = strategy.next(None, MadeUpArm().forecast)
    assert isinstance(plan, PlannedTrial)
    ending = strategy.next(report_of(plan, Outcome.ABORTED), MadeUpArm().forecast)
    assert isinstance(ending, Ending)
    assert ending.outcome == "aborted"
    assert "no easier movement" in ending.message


@pytest.mark.parametrize(
    ("vary", "expected"),
    [
        # 0.125 rad of deviation are a quarter of half the tolerance: half the slowness would have done.
        (("amplitude", "speed"), Movement(11.5, amplitude=1.0)),
        (("stiffness", "speed"), Movement(11.5, stiffness=1.0)),
        # How easy one path is says nothing about another one.
        (("shape", "speed"), Movement(11.5, shape=0.0)),
    ],
    ids=lambda x: ",".join(x) if isinstance(x, tuple) else "",
)
def test_after_an_abort_practice_goes_back_to_what_is_safe_without_a_network(
    vary: tuple[str, ...], expected: Movement
) -> None:
    practice: dict[str, Any] = {"first_amplitude": 0.25, "first_stiffness": 4.0}
    strategy = AdaptiveExtension(config_of(vary=vary, **practice))
    last = None
    while True:
        plan = strategy.next(last, forecast_of_a_good_learner if last else MadeUpArm().forecast)
        assert isinstance(plan, PlannedTrial)
        if plan.movement.duration_s < 6.5:
            break
        last = report_of(plan, rms_error_rad=2e-3, max_error_rad=0.125)
    back = strategy.next(report_of(plan, Outcome.ABORTED), forecast_of_a_good_learner)
    assert isinstance(back, PlannedTrial)
    assert back.movement == expected


def test_after_an_abort_of_the_first_trial_a_smaller_movement_is_tried() -> None:
    strategy = AdaptiveExtension(config_of(vary=("amplitude",)))
    plan = strategy.next(None, MadeUpArm().forecast)
    assert isinstance(plan, PlannedTrial)
    smaller = strategy.next(report_of(plan, Outcome.ABORTED), MadeUpArm().forecast)
    assert isinstance(smaller, PlannedTrial)
    assert smaller.movement.amplitude == pytest.approx(0.15)
    assert smaller.go_back_to == 0


def test_with_only_the_speed_it_is_practice_as_ever() -> None:
    """The same plans whether the course is given or not, and no other words."""
    config = config_of()
    default = practise(AdaptiveExtension(config), MadeUpArm())
    given = Course([Leg("speed", 11.5, 4.5)], Movement(4.5))
    explicit = practise(AdaptiveExtension(config, given), MadeUpArm())
    assert [plan.movement for plan in default[0]] == [plan.movement for plan in explicit[0]]
    assert default[2] == explicit[2]
    assert default[2].message.startswith("4.5 s reached with")


@pytest.mark.parametrize(
    ("key", "bad", "expected"),
    [
        ("vary", (), "one or more of speed, amplitude, shape, stiffness, each once"),
        ("vary", ("speed", "speed"), "each once"),
        ("vary", ("weight",), "one or more of"),
        *(("first_amplitude", bad, "above 0 and up to 1") for bad in (0.0, -0.1, 1.1, math.nan)),
        *(("first_stiffness", bad, "at least 1") for bad in (0.9, math.nan, math.inf)),
        *(("parts", bad, "a whole number of at least 2") for bad in (1, 0, -3)),
    ],
)
def test_what_practice_cannot_vary_is_refused(key: str, bad: Any, expected: str) -> None:
    with pytest.raises(ConfigError, match=expected) as refusal:
        PracticeConfig(**{key: bad})
    assert refusal.value.key == key


@pytest.mark.parametrize(
    ("values", "key"),
    [
        ({"vary": ("amplitude",), "durations_s": (9.0,)}, "vary"),
        ({"vary": ("amplitude",), "strategy": "subtasks"}, "practice.vary"),
        ({"vary": ("amplitude", "speed"), "trials": 2}, "practice.trials"),
    ],
)
def test_settings_that_contradict_what_varies_are_refused(values: dict[str, Any], key: str) -> None:
    with pytest.raises(ConfigError) as refusal:
        make_strategy(config_of(**values))
    assert refusal.value.key == key


def whole_config(path: dict[str, str], practice: dict[str, Any], control: dict[str, Any]) -> Config:
    return Config(
        arm=config_of().arm,
        path=PathConfig(name="planar_loops", **path),
        practice=PracticeConfig(**practice),
        control=ControlConfig(**control),
    )


def test_a_known_path_is_there_if_and_only_if_the_shape_varies() -> None:
    with pytest.raises(ConfigError, match="a path to begin with"):
        whole_config({}, {"vary": ("shape",)}, {})
    with pytest.raises(ConfigError, match="nothing, because practice.vary has no shape"):
        whole_config({"known_name": "planar_loops"}, {}, {})
    with pytest.raises(ConfigError, match="a name or a file .* and not both"):
        PathConfig(name="planar_loops", known_name="planar_loops", known_file="a.csv")
    assert whole_config({"known_file": "a.csv"}, {"vary": ("shape",)}, {}).path.known_file == "a.csv"


def test_the_first_stiffness_is_one_that_the_controller_takes() -> None:
    practice: dict[str, Any] = {"vary": ("stiffness",), "first_stiffness": 10.5}
    with pytest.raises(ConfigError, match="at most control.max_stiffness_factor = 10.0"):
        whole_config({}, practice, {})
    whole_config({}, practice, {"max_stiffness_factor": 11.0})
    for bad in (0.5, math.nan, math.inf):
        with pytest.raises(ConfigError, match="a finite number of at least 1"):
            ControlConfig(max_stiffness_factor=bad)
