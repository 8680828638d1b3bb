"""The minimum-jerk time scaling."""

from __future__ import annotations

import numpy as np

from tel_ros.core.trajectories.time_scaling import MINIMUM_JERK_PEAK_SPEED, minimum_jerk


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
