"""Timings go from rest to rest, and their derivatives are those of their values."""

from __future__ import annotations

import numpy as np
import pytest

from tel_ros.core.trajectories.timing import (
    MINIMUM_JERK_PEAK_SPEED,
    MinimumJerk,
    SmoothedSpeed,
    Timing,
    minimum_jerk,
)
from tel_ros.core.types import NS_PER_S

BANG_BANG = SmoothedSpeed(
    knot_s=np.array([0.0, 0.5, 0.7, 1.2]),
    travelled=np.array([0.0, 0.5 / 1.4, 0.9 / 1.4, 1.0]),
    speed_per_s=np.array([0.0, 2.0, 2.0, 0.0]) / 1.4,
    window_s=0.1,
)


def test_minimum_jerk_goes_from_rest_to_rest() -> None:
    s, ds, dds = minimum_jerk(np.array([0.0, 1.0]))
    np.testing.assert_array_equal(s, [0.0, 1.0])
    np.testing.assert_array_equal(ds, [0.0, 0.0])
    np.testing.assert_array_equal(dds, [0.0, 0.0])


def test_minimum_jerk_is_held_at_the_ends_outside_the_movement() -> None:
    s, ds, dds = minimum_jerk(np.array([-3.0, 1.0 + 1e-9, 7.0]))
    np.testing.assert_array_equal(s, [0.0, 1.0, 1.0])
    np.testing.assert_array_equal(ds, 0.0)
    np.testing.assert_array_equal(dds, 0.0)


def test_minimum_jerk_never_goes_back_and_is_symmetric_in_time() -> None:
    p = np.linspace(0.0, 1.0, 1001)
    s, ds, _ = minimum_jerk(p)
    assert np.all(np.diff(s) >= 0.0)
    np.testing.assert_allclose(s + s[::-1], 1.0, atol=1e-15)  # rounding only
    np.testing.assert_allclose(ds, ds[::-1], atol=1e-14)


def test_derivatives_of_minimum_jerk_are_those_of_its_values() -> None:
    h = 1e-5
    p = np.linspace(0.01, 0.99, 99)
    _, ds, dds = minimum_jerk(p)
    (above, ds_above, _), (below, ds_below, _) = minimum_jerk(p + h), minimum_jerk(p - h)
    # Truncation h² s''' / 6 with s''' <= 60, plus rounding 1e-16 / h.
    np.testing.assert_allclose(ds, (above - below) / (2 * h), atol=1e-8)
    np.testing.assert_allclose(dds, (ds_above - ds_below) / (2 * h), atol=1e-8)


def test_the_peak_speed_is_reached_in_the_middle() -> None:
    _, ds, _ = minimum_jerk(np.linspace(0.0, 1.0, 1001))
    assert ds.max() == ds[500] == MINIMUM_JERK_PEAK_SPEED


@pytest.mark.parametrize("timing", [MinimumJerk(1.3), BANG_BANG])
def test_a_timing_goes_from_rest_to_rest_and_is_held_there(timing: Timing) -> None:
    end_ns = round(timing.duration_s * NS_PER_S)
    s, ds, dds = timing.at(np.array([-1_000_000, 0, end_ns, 2 * end_ns]))
    np.testing.assert_allclose(s, [0.0, 0.0, 1.0, 1.0], atol=1e-14)
    np.testing.assert_allclose(ds, 0.0, atol=1e-7)  # the end is rounded to a nanosecond
    assert ds[0] == ds[1] == dds[0] == dds[1] == 0.0


@pytest.mark.parametrize("timing", [MinimumJerk(1.3), BANG_BANG])
def test_derivatives_of_a_timing_are_those_of_its_values(timing: Timing) -> None:
    step_ns = 10_000
    time_ns = np.arange(step_ns, round(timing.duration_s * NS_PER_S), 1_111_111)
    _, ds, dds = timing.at(time_ns)
    (above, ds_above, _), (below, ds_below, _) = timing.at(time_ns + step_ns), timing.at(time_ns - step_ns)
    width_s = 2 * step_ns / NS_PER_S
    np.testing.assert_allclose((above - below) / width_s, ds, atol=1e-6)
    np.testing.assert_allclose((ds_above - ds_below) / width_s, dds, atol=2e-3)  # it has corners


def test_smoothing_turns_jumps_of_the_acceleration_into_ramps_as_long_as_the_window() -> None:
    time_ns = np.arange(0, round(BANG_BANG.duration_s * NS_PER_S), 1_000_000)
    dds = BANG_BANG.at(time_ns)[2]
    highest = 4.0 / 1.4
    assert np.abs(np.diff(dds)).max() <= highest * 0.001 / BANG_BANG.window_s * (1.0 + 1e-9)
    assert dds[time_ns == 50_000_000] == pytest.approx(0.5 * highest)
    assert dds[time_ns == 300_000_000] == pytest.approx(highest)
