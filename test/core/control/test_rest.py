"""Telling rest from motion by positions that are read in steps and with noise."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from tel_ros.core.control.rest import RestDetector
from tel_ros.core.types import NS_PER_S

SPEED_RAD_S, WINDOW_S, RATE_HZ = 0.05, 0.2, 500.0


def first_rest_s(
    position_rad: Callable[[float], float], until_s: float = 5.0, start_s: float = 0.0
) -> float | None:
    """Return when a joint first counts as at rest (a second one stands still), or None."""
    detector = RestDetector(SPEED_RAD_S, WINDOW_S)
    for k in range(round(until_s * RATE_HZ)):
        time_s = k / RATE_HZ
        if detector.at_rest(round((start_s + time_s) * NS_PER_S), np.array([1.0, position_rad(time_s)])):
            return time_s
    return None


@pytest.mark.parametrize("start_s", [0.0, 1.7e9], ids=["from_zero", "since_1970"])
def test_an_arm_that_stands_still_is_at_rest_after_the_window_and_not_before(start_s: float) -> None:
    # Stamps are whole nanoseconds but 1.7e9 s as a float is only good to 0.2 µs: the tick after is as right.
    assert first_rest_s(lambda t: 0.3, start_s=start_s) == pytest.approx(WINDOW_S, abs=1.1 / RATE_HZ)


def test_the_noise_of_an_encoder_does_not_count_as_motion() -> None:
    step = 2 * np.pi / 2**12  # 1.5 mrad; differences of successive readings are up to 0.77 rad/s
    rng = np.random.default_rng(0)
    rest_s = first_rest_s(lambda t: round((0.3 + rng.normal(0.0, step)) / step) * step)
    assert rest_s == pytest.approx(WINDOW_S)


@pytest.mark.parametrize("factor", [1.1, 3.0, -1.1])
def test_a_slow_drift_above_the_speed_is_never_rest(factor: float) -> None:
    assert first_rest_s(lambda t: factor * SPEED_RAD_S * t) is None


def test_a_drift_below_the_speed_counts_as_rest() -> None:
    assert first_rest_s(lambda t: 0.9 * SPEED_RAD_S * t) == pytest.approx(WINDOW_S)


def test_a_swing_through_the_same_place_is_not_rest() -> None:
    """The default arm rings at about 1 Hz and stands still for a moment at each turn."""
    assert first_rest_s(lambda t: 0.1 * np.sin(2 * np.pi * t)) is None


def test_the_window_begins_anew_after_a_motion() -> None:
    detector = RestDetector(SPEED_RAD_S, WINDOW_S)
    seen = [
        detector.at_rest(round(time_s * NS_PER_S), np.array([position]))
        for time_s, position in [(0.0, 0.0), (0.15, 0.0), (0.16, 0.5), (0.25, 0.5), (0.35, 0.5), (0.36, 0.5)]
    ]
    assert seen == [False, False, False, False, False, True]


def test_a_clock_that_was_set_back_begins_the_window_anew() -> None:
    detector = RestDetector(SPEED_RAD_S, WINDOW_S)
    seen = [
        detector.at_rest(round(time_s * NS_PER_S), np.array([0.0]))
        for time_s in (100.0, 100.2, 50.0, 50.1, 50.2)
    ]
    assert seen == [False, True, False, False, True]
