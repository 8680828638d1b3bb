"""When the periods of the simulated arm pass, and whether it stands still."""

from __future__ import annotations

import numpy as np
import pytest

from sim_bridge.timing import Allowance, Due, Pacer, Stillness
from tel_ros.core.config import ControlConfig
from tel_ros.core.control.holding import RestDetector

PERIOD_S = 0.002


def pacer(start_s: float = 1000.0) -> Pacer:
    return Pacer(PERIOD_S, start_s, longest_s=1.0)


def test_a_period_passes_when_it_has_ended_and_not_before() -> None:
    paced = pacer()
    assert paced.deadline_s == pytest.approx(1000.002)
    assert paced.due(1000.0019) == Due(0)
    assert paced.due(paced.deadline_s) == Due(1)
    assert paced.due(1000.0021) == Due(0)


def test_a_late_period_does_not_make_the_next_ones_late() -> None:
    paced = pacer()
    late_s = [0.0, 0.0015, 0.0003, 0.0019, 0.0]
    for k, late in enumerate(late_s):
        assert paced.deadline_s == pytest.approx(1000.0 + (k + 1) * PERIOD_S, abs=1e-9)
        assert paced.due(1000.0 + (k + 1) * PERIOD_S + late + 1e-9) == Due(1)


def test_after_a_stall_all_periods_that_have_gone_by_pass_at_once() -> None:
    paced = pacer()
    assert paced.due(1000.0 + 0.3001) == Due(150)
    assert paced.due(1000.0 + 0.3011) == Due(0)
    assert paced.deadline_s == pytest.approx(1000.302)


def test_what_a_stall_has_beyond_the_longest_is_skipped_and_the_clock_stays_right() -> None:
    paced = pacer()
    due = paced.due(1000.0 + 3.0001)
    assert (due.periods, due.skipped_s) == (500, pytest.approx(2.0))
    assert paced.deadline_s == pytest.approx(1003.002)


def test_each_deadline_brings_at_least_one_period_however_it_rounds() -> None:
    paced = Pacer(1.0 / 3.0, 123456.789, longest_s=1.0)
    for _ in range(1000):
        deadline_s = paced.deadline_s
        assert paced.due(deadline_s).periods == 1
        assert paced.deadline_s > deadline_s


def allowed(allowance: Allowance, stamp: int, now_s: float, *, has_client: bool, busy: bool = True) -> int:
    """Return how many periods may pass after the state with this number."""
    stamp_ns = round(stamp * PERIOD_S * 1e9)
    return allowance.periods(stamp_ns, now_s, has_client=has_client, busy=busy)


def test_without_a_client_periods_pass_at_once_while_there_is_something_to_do() -> None:
    allowance = Allowance(PERIOD_S, timeout_s=2.0, ahead=8)
    assert allowed(allowance, 0, 1.0, has_client=False) == Allowance.MOST
    assert allowed(allowance, 0, 1.0, has_client=False, busy=False) == 0


def test_a_client_is_never_more_than_so_many_states_behind() -> None:
    allowance = Allowance(PERIOD_S, timeout_s=2.0, ahead=8)
    assert allowed(allowance, 0, 0.5, has_client=True, busy=False) == 0
    assert allowed(allowance, 0, 1.0, has_client=True) == 0
    allowance.hear(round(100 * PERIOD_S * 1e9), 1.0)
    assert allowed(allowance, 103, 1.0, has_client=True) == 5
    assert allowed(allowance, 108, 1.0, has_client=True) == 0
    assert allowed(allowance, 104, 1.0, has_client=True, busy=False) == 4


def test_a_client_that_falls_silent_has_the_rest_of_a_movement_pass_in_real_time() -> None:
    allowance = Allowance(PERIOD_S, timeout_s=2.0, ahead=8)
    allowance.hear(0, 1.0)
    assert allowed(allowance, 8, 2.99, has_client=True) == 0
    passed, now_s = 0, 3.0
    while now_s < 3.1:
        passed += allowed(allowance, 8 + passed, now_s, has_client=True)
        now_s += 0.1 * PERIOD_S
    assert passed == pytest.approx(0.1 / PERIOD_S, rel=0.1)
    assert allowed(allowance, 99, 9.0, has_client=True, busy=False) == 0
    assert allowed(allowance, 99, 9.1, has_client=True) == 0, "a new movement waits anew"


CONTROL = ControlConfig(rate_hz=500.0, settle_time_s=0.2, settle_speed_rad_s=0.05)


@pytest.mark.parametrize("seed", range(20))
def test_whatever_the_controller_calls_rest_is_rest_here(seed: int) -> None:
    rng = np.random.default_rng(seed)
    detector = RestDetector(CONTROL.settle_speed_rad_s, CONTROL.settle_time_s)
    stillness = Stillness(CONTROL)
    amplitude, frequency_hz = rng.uniform(0.02, 0.2), rng.uniform(0.5, 10.0, 2)
    fast = 0
    for k in range(3000):
        t = k / 500.0
        swing = 2.0 * np.pi * frequency_hz
        position = amplitude * np.exp(-t) * np.sin(swing * t)
        if detector.at_rest(k * 2_000_000, position):
            # One more period passes with the last command.
            stillness.add(tuple(amplitude * np.exp(-t - 0.002) * np.sin(swing * (t + 0.002))))
            assert stillness.stands_still
            break
        stillness.add(tuple(position))
        fast = max(fast, k)
    assert fast > 100, "it came to rest at once"


def test_an_arm_in_motion_does_not_stand_still() -> None:
    stillness = Stillness(CONTROL)
    for k in range(200):
        stillness.add((0.0, 0.5 * k / 500.0))
    assert not stillness.stands_still


def test_an_arm_that_nobody_has_moved_stands_still() -> None:
    assert Stillness(CONTROL).stands_still
