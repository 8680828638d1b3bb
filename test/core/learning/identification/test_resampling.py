"""Even samples from uneven ones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from made_up_recording import made_up


def test_a_recording_is_cut_where_time_is_missing_and_nowhere_else() -> None:
    recording = made_up(10.0, 125.0).recording
    whole = list(recording.unbroken())
    assert len(whole) == 1
    missing = (recording.time_s > 4.0) & (recording.time_s < 4.5)
    first, second = recording[~missing].unbroken()
    assert first.time_s[-1] < 4.0
    assert second.time_s[0] > 4.5


def test_one_lost_sample_of_a_slow_recording_does_not_cut_it() -> None:
    recording = made_up(10.0, 30.0, jitter=0.0).recording
    kept = np.ones(len(recording.time_s), dtype=bool)
    kept[100] = False
    assert len(list(recording[kept].unbroken())) == 1
    kept[100:103] = False
    assert len(list(recording[kept].unbroken())) == 2


def test_samples_that_say_the_same_become_their_mean() -> None:
    recording = made_up(4.0, 100.0, jitter=0.0).recording
    twice = replace(
        recording,
        time_s=np.repeat(recording.time_s, 2),
        position_rad=np.repeat(recording.position_rad, 2, axis=0) + np.tile([[0.01], [-0.01]], (400, 1)),
        effort_nm=np.repeat(recording.effort_nm, 2, axis=0),
    )
    (part,) = twice.unbroken()
    np.testing.assert_allclose(part.time_s, recording.time_s)
    np.testing.assert_allclose(part.position_rad, recording.position_rad, atol=1e-12)
    np.testing.assert_allclose(part.effort_nm, recording.effort_nm)


def test_samples_that_all_have_one_stamp_make_no_part() -> None:
    recording = made_up(4.0).recording
    assert list(replace(recording, time_s=np.zeros_like(recording.time_s)).unbroken()) == []


@pytest.mark.parametrize("rate_hz", [30.0, 125.0, 1000.0])
def test_jitter_is_taken_out(rate_hz: float) -> None:
    made = made_up(8.0, rate_hz, noise_rad=0.0)
    period_s = made.recording.median_period_s
    assert period_s == pytest.approx(1.0 / rate_hz, rel=0.05)
    time_s, position, _ = made.recording.evenly_sampled(period_s)
    np.testing.assert_allclose(np.diff(time_s), period_s)
    wrong = np.abs(position - made.truth(time_s)[:, :2])[5:-5].max()
    linear = np.column_stack(
        [np.interp(time_s, made.recording.time_s, q) for q in made.recording.position_rad.T]
    )
    assert wrong < 0.1 * np.abs(linear - made.truth(time_s)[:, :2])[5:-5].max()
