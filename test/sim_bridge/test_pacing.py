"""When the periods of the simulated arm pass, by a clock that the test moves."""

from __future__ import annotations

import pytest

from sim_bridge.pacing import Due, Pacer

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
