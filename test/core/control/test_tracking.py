"""Keeping score of a trial."""

from __future__ import annotations

import numpy as np

from tel_ros.core.control.tracking import TrackingScore


def test_the_score_is_that_of_all_ticks_together() -> None:
    rng = np.random.default_rng(1)
    errors, efforts = rng.normal(size=(50, 3)), rng.normal(size=(50, 3))
    saturated = rng.random((50, 3)) < 0.1
    score = TrackingScore(3)
    for row in zip(errors, efforts, saturated, strict=True):
        score.add(*row)
    assert score.ticks == 50
    # Sums in another order: rounding.
    np.testing.assert_allclose(score.rms_error_rad, np.sqrt(np.mean(errors**2)), rtol=1e-12)
    np.testing.assert_allclose(score.rms_error_per_joint_rad, np.sqrt(np.mean(errors**2, axis=0)), rtol=1e-12)
    assert score.max_error_rad == np.abs(errors).max()
    np.testing.assert_array_equal(score.max_effort_nm, np.abs(efforts).max(axis=0))
    assert score.saturated_ratio == np.mean(saturated.any(axis=1))


def test_without_a_tick_there_is_no_error_to_speak_of() -> None:
    score = TrackingScore(2)
    assert np.isnan(score.rms_error_rad)
    assert np.isnan(score.rms_error_per_joint_rad).all()
    assert np.isnan(score.max_error_rad)
    assert np.isnan(score.saturated_ratio)
