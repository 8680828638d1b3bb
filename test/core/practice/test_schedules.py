"""Schedules of what else varies besides the speed."""

from __future__ import annotations

import numpy as np
import pytest
from made_up_arm import config_of, report_of

from tel_ros.core.practice.strategies import make_strategy
from tel_ros.core.practice.strategy import Ending, Forecast, Movement, PlannedTrial


def no_forecast(movement: Movement) -> Forecast:
    raise AssertionError("a forecast was asked for")


def plans_of(*vary: str, **practice: object) -> list[PlannedTrial]:
    """Return the trials of a run in which nothing goes wrong."""
    strategy = make_strategy(config_of(vary=vary, **practice))
    preview, plans, last = strategy.preview(), [], None
    while isinstance(decision := strategy.next(last, no_forecast), PlannedTrial):
        plans.append(decision)
        last = report_of(decision)
    assert decision == Ending("completed")
    assert list(preview) == [plan.movement for plan in plans]
    return plans


def test_the_amplitude_goes_up_in_equal_ratios_at_the_goal_speed() -> None:
    movements = [plan.movement for plan in plans_of("amplitude", trials=5, first_amplitude=0.3)]
    amplitude = np.array([movement.amplitude for movement in movements])
    np.testing.assert_allclose(amplitude, np.geomspace(0.3, 1.0, 5), rtol=1e-12)
    assert amplitude[-1] == 1.0
    assert {movement.duration_s for movement in movements} == {4.5}


def test_the_shape_goes_up_in_even_steps() -> None:
    shares = [plan.movement.shape for plan in plans_of("shape", trials=5)]
    np.testing.assert_allclose(shares, np.linspace(0.0, 1.0, 5), atol=1e-12)
    assert (shares[0], shares[-1]) == (0.0, 1.0)


def test_the_stiffness_goes_down_in_equal_ratios() -> None:
    stiffness = [plan.movement.stiffness for plan in plans_of("stiffness", trials=5, first_stiffness=4.0)]
    np.testing.assert_allclose(stiffness, np.geomspace(4.0, 1.0, 5), rtol=1e-12)
    assert stiffness[-1] == 1.0


@pytest.mark.parametrize("spacing", ["duration", "speed", "torque"])
def test_several_things_go_one_after_the_other_with_the_trials_spread_over_them(spacing: str) -> None:
    plans = plans_of("amplitude", "speed", "stiffness", trials=9, spacing=spacing)
    movements = [plan.movement for plan in plans]
    assert movements[0] == Movement(11.5, amplitude=0.3, stiffness=4.0)
    assert movements[2] == Movement(11.5, stiffness=4.0), "the first leg ends as it should"
    assert movements[5] == Movement(4.5, stiffness=4.0)
    assert movements[8] == Movement(4.5)
    assert len(set(movements)) == 9, "where two legs meet there is one trial"
    power = {"duration": 1.0, "speed": -1.0, "torque": -2.0}[spacing]
    steps = np.diff([movement.duration_s**power for movement in movements[2:6]])
    np.testing.assert_allclose(steps, steps[0], rtol=1e-9)


def test_alpha_rises_to_one() -> None:
    alphas = [plan.alpha for plan in plans_of("amplitude", "speed", trials=7)]
    assert alphas[0] == pytest.approx(0.3 * 4.5 / 11.5)
    assert np.all(np.diff(alphas) > 0.0)
    assert alphas[-1] == 1.0


def test_practice_at_the_goal_from_the_start_varies_nothing() -> None:
    plans = plans_of("amplitude", strategy="direct", trials=3)
    assert [plan.movement for plan in plans] == [Movement(4.5)] * 3
    assert {plan.alpha for plan in plans} == {1.0}
