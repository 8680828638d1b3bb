"""Medians that may be "never", and rankings that a single lucky arm does not decide."""

from __future__ import annotations

import math

import pytest

from tel_lab.comparison.statistics import is_worse, median, standing


def test_the_interval_of_ten_values_lies_between_the_second_and_the_ninth() -> None:
    """Binomial: P(2 to 8 of 10 values are below the median) = 0.979, and 0.891 for 3 to 7."""
    found = median([10.0, 3.0, 1.0, 7.0, 5.0, 2.0, 9.0, 4.0, 8.0, 6.0])
    assert (found.value, found.low, found.high) == (5.5, 2.0, 9.0)


def test_values_that_are_never_reached_count_as_the_largest() -> None:
    found = median([1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, math.inf, math.inf, math.inf])
    assert (found.value, found.high) == (5.5, math.inf)
    assert median([math.inf] * 4).value == math.inf


def test_few_values_have_a_median_but_no_interval() -> None:
    found = median([2.0, 1.0, 3.0])
    assert found.value == 2.0
    assert math.isnan(found.low) and math.isnan(found.high)


@pytest.mark.parametrize(
    ("n_larger", "worse"),
    [(8, False), (9, True), (10, True)],  # P(at least 8 of 10) = 0.055, P(at least 9) = 0.011
)
def test_worse_means_worse_on_nearly_all_arms(n_larger: int, worse: bool) -> None:
    one = [2.0] * n_larger + [0.0] * (10 - n_larger)
    assert is_worse(one, [1.0] * 10) is worse


def test_equal_values_tell_nothing_about_which_is_worse() -> None:
    assert not is_worse([math.inf] * 10, [math.inf] * 10)
    assert not is_worse([2.0] + [1.0] * 9, [1.0] * 10)


def test_standings() -> None:
    values = {
        "good": [1.0 + 0.01 * k for k in range(10)],
        "equal": [1.0 + 0.01 * k for k in range(10)],
        "as good": [0.9, 0.9, 0.9, 0.9, 0.9, 0.9, 2.0, 2.0, 2.0, 2.0],
        "bad": [3.0] * 9 + [math.inf],
    }
    assert standing("as good", values).rank == "first"
    assert standing("good", {name: values[name] for name in ("good", "equal", "bad")}).rank == "first"
    tied = standing("good", values)
    assert (tied.rank, tied.rivals) == ("tied", ("as good",))
    behind = standing("bad", values)
    assert behind.rank == "behind"
    assert set(behind.rivals) == {"good", "equal", "as good"}
    assert behind.rivals[0] == "as good"  # the lowest median
