"""What a recording refuses, and its unbroken parts on an even time grid."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from made_up_recording import made_up

from tel_ros.core.errors import InputFileError
from tel_ros.core.learning.joint_recording import JointRecording

RECORDING = made_up(2.0, 100.0).recording


def changed(name: str, joint: int, value: float, rows: slice = slice(None)) -> JointRecording:
    values = getattr(RECORDING, name).copy()
    values[rows, joint] = value
    return replace(RECORDING, **{name: values})


def swapped(k: int) -> JointRecording:
    time_s = RECORDING.time_s.copy()
    time_s[[k, k + 1]] = time_s[[k + 1, k]]
    return replace(RECORDING, time_s=time_s)


def test_a_good_one_is_let_pass() -> None:
    RECORDING.require_learnable()


@pytest.mark.parametrize(
    ("recording", "parts"),
    [
        (RECORDING[:49], ["49 samples", "at least 50"]),
        (swapped(30), ["sample 32", "before", "1 such places"]),
        (changed("effort_nm", 1, np.nan), ["no effort for elbow", "--joints"]),
        (changed("effort_nm", 0, 0.0), ["effort of shoulder is 0 N·m throughout", "--joints"]),
        (changed("position_rad", 1, 0.3), ["elbow stands still at 0.3 rad", "--joints"]),
        (changed("position_rad", 1, np.inf, slice(3, 4)), ["elbow has positions that are not finite"]),
    ],
)
def test_what_cannot_be_learned_from_is_refused(recording: JointRecording, parts: list[str]) -> None:
    with pytest.raises(InputFileError) as caught:
        recording.require_learnable()
    assert str(caught.value).startswith("made up: ")
    for part in parts:
        assert part in str(caught.value)


def test_joints_are_taken_in_the_order_that_is_asked_for() -> None:
    found = RECORDING.of(["elbow", "shoulder"])
    np.testing.assert_array_equal(found.position_rad, RECORDING.position_rad[:, ::-1])
    np.testing.assert_array_equal(found.effort_nm, RECORDING.effort_nm[:, ::-1])
    with pytest.raises(InputFileError, match="no joint wrist; expected joints among shoulder, elbow"):
        RECORDING.of(["elbow", "wrist"])


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
