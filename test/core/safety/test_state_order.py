"""Which states a newer one has overtaken."""

from __future__ import annotations

import pytest

from tel_ros.core.safety.state_order import StateOrder

MS = 1_000_000


def used(stamps_ms: list[float], timeout_s: float = 0.1) -> list[float]:
    order = StateOrder(timeout_s)
    return [ms for ms in stamps_ms if order.overtaken_by_s(round(ms * MS)) == 0.0]


def test_neighbours_that_change_places_give_the_newer_of_each_two() -> None:
    assert used([0, 8, 4, 16, 12, 20]) == [0, 8, 16, 20]


def test_a_state_that_is_sent_again_is_no_older_one() -> None:
    assert used([0, 4, 4, 4, 8]) == [0, 4, 4, 4, 8]


def test_a_clock_that_was_set_back_counts_from_then_on() -> None:
    assert used([1000, 1004, 904, 908, 912]) == [1000, 1004, 904, 908, 912]  # by the time-out
    assert used([1000, 900.5, 950, 999.5, 1000.5]) == [1000, 1000.5]  # by a little less


def test_it_tells_by_how_much() -> None:
    order = StateOrder(0.1)
    order.overtaken_by_s(100 * MS)
    assert order.overtaken_by_s(60 * MS) == pytest.approx(0.04)
