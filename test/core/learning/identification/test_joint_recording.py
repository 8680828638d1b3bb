"""Recordings that nothing can be learned from are refused, and the message says why."""

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
