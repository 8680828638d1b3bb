"""How regular a loop was, from the times of its ticks."""

from __future__ import annotations

import numpy as np
import pytest

from tel_ros.core.control.loop_timing import LoopTimer, missed_ticks
from tel_ros.core.trial import LoopTiming

RATE_HZ = 500.0
PERIOD_NS = 2_000_000
START_NS = 1_752_000_000_000_000_000  # a time of day, which needs all 64 bits


def timing(
    stamps_ns: np.ndarray, arrived_ns: np.ndarray, response_ns: np.ndarray | int = 300_000
) -> LoopTiming:
    timer = LoopTimer(RATE_HZ, capacity=len(stamps_ns))
    answered_ns = arrived_ns + response_ns
    for row in zip(stamps_ns.tolist(), arrived_ns.tolist(), answered_ns.tolist(), strict=True):
        timer.add(*row)
    found = timer.timing()
    assert found is not None
    return found


def regular(n: int = 1001) -> np.ndarray:
    return START_NS + PERIOD_NS * np.arange(n)


def test_a_regular_loop_has_its_rate_no_jitter_and_nothing_to_warn_about() -> None:
    assert timing(regular(), regular() - START_NS) == LoopTiming(
        state_rate_hz=pytest.approx(500.0),
        stamp_rate_hz=pytest.approx(500.0),
        jitter_p50_s=pytest.approx(0.0, abs=1e-12),
        jitter_p99_s=pytest.approx(0.0, abs=1e-12),
        jitter_max_s=pytest.approx(0.0, abs=1e-12),
        response_p99_s=pytest.approx(3e-4),
        response_max_s=pytest.approx(3e-4),
        missed_ticks=0,
    )


def test_one_state_that_arrives_late_is_two_intervals_of_jitter_and_no_missed_tick() -> None:
    arrived_ns = regular()
    arrived_ns[500] += 700_000
    found = timing(regular(), arrived_ns)
    assert found.jitter_max_s == pytest.approx(7e-4)
    assert found.jitter_p99_s == pytest.approx(0.0, abs=1e-12)  # 2 of 1000 intervals
    assert (found.missed_ticks, found.warning) == (0, "")


def test_response_is_from_the_arrival_to_the_answer() -> None:
    response_ns = np.full(1001, 200_000)
    response_ns[-20:] = 900_000  # more than 1 in 100
    response_ns[3] = 1_900_000
    found = timing(regular(), regular(), response_ns)
    assert found.response_p99_s == pytest.approx(9e-4)
    assert found.response_max_s == pytest.approx(1.9e-3)


@pytest.mark.parametrize(
    ("interval_ns", "expected"),
    [
        (2_000_000, 0),
        (2_900_000, 0),  # late by less than half a period
        (3_100_000, 1),
        (4_000_000, 1),
        (5_100_000, 2),
        (40_000_000, 19),
        (100_000, 0),  # early
        (-2_000_000, 0),  # back: that is not a matter of being late
    ],
)
def test_a_tick_is_missed_when_no_stamp_lies_within_half_a_period_after_it(
    interval_ns: int, expected: int
) -> None:
    stamps_ns = regular(10)
    stamps_ns[5:] += interval_ns - PERIOD_NS
    assert missed_ticks(stamps_ns, RATE_HZ) == expected


def test_states_that_never_came_are_missed_and_lower_the_rate_but_not_that_of_a_slow_arm() -> None:
    kept = np.arange(1001) % 10 != 9  # one in ten is lost
    found = timing(regular()[kept], regular()[kept])
    assert found.missed_ticks == 100
    assert found.state_rate_hz == pytest.approx(450.0, rel=1e-3)
    slow = timing(regular(), START_NS + 2 * (regular() - START_NS))
    assert (slow.missed_ticks, slow.stamp_rate_hz) == (0, pytest.approx(500.0))
    assert slow.state_rate_hz == pytest.approx(250.0)


@pytest.mark.parametrize(
    ("spoil", "expected"),
    [
        ("slow", "states came at 480.8 Hz instead of 500 Hz; stamps show 480.8 Hz"),
        ("missed", "20 of 1001 ticks were missed"),
        ("jitter", "1 in 100 states was early or late by 1.20 ms or more (period 2.00 ms)"),
        ("response", "1 in 100 answers took 1.50 ms or more (period 2.00 ms)"),
        ("gap", "one state was 25.0 ms late"),
    ],
)
def test_what_is_bad_is_said_with_its_numbers(spoil: str, expected: str) -> None:
    stamps_ns, arrived_ns, response_ns = regular(), regular(), 300_000
    if spoil == "slow":
        stamps_ns = arrived_ns = START_NS + 2_080_000 * np.arange(1001)
    elif spoil == "missed":
        kept = np.ones(1001, dtype=bool)
        kept[100:900:40] = False
        stamps_ns = arrived_ns = regular()[kept]
    elif spoil == "jitter":
        arrived_ns = regular()
        arrived_ns[10:1000:50] += 1_200_000
    elif spoil == "response":
        response_ns = 1_500_000
    else:
        arrived_ns = regular()
        arrived_ns[500] += 25_000_000
    warning = timing(stamps_ns, arrived_ns, response_ns).warning
    assert warning.startswith("the loop was not regular: ")
    assert expected in warning


def test_stamps_that_stand_still_have_no_rate_and_are_warned_about() -> None:
    found = timing(np.full(5, START_NS), regular(5))
    assert np.isnan(found.stamp_rate_hz)
    assert "stamps show nan Hz" in found.warning


def test_each_trial_is_measured_on_its_own_and_may_be_longer_than_foreseen() -> None:
    timer = LoopTimer(RATE_HZ, capacity=4)
    timer.add(0, 0, 50_000_000)
    assert timer.timing() is None  # one state has no interval
    timer.reset()
    for time_ns in regular(50).tolist():
        timer.add(time_ns, time_ns, time_ns + 100_000)
    found = timer.timing()
    assert found is not None
    assert found.response_max_s == pytest.approx(1e-4)
    assert found.state_rate_hz == pytest.approx(500.0)
    timer.reset()
    assert timer.timing() is None
