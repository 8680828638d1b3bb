"""Nothing that is held out is known from its neighbours."""

from __future__ import annotations

import numpy as np
import pytest
from made_up_recording import made_up

from tel_ros.core.errors import TrainingError
from tel_ros.core.learning.torque_fit import N_FOLDS, blocks_of, folds, gap_s
from tel_ros.core.learning.torque_samples import TorqueSamples, torque_samples


@pytest.fixture(scope="module")
def parts() -> list[TorqueSamples]:
    """Two unbroken parts of a recording."""
    recording = made_up(40.0, 50.0).recording
    return torque_samples(recording[(recording.time_s < 15.0) | (recording.time_s > 16.0)])


def test_every_sample_is_held_out_once(parts: list[TorqueSamples]) -> None:
    assert len(parts) == 2
    found = folds(parts, blocks_of(parts))
    assert len(found) == N_FOLDS
    held_out = np.concatenate([block.time_s for fold in found for block in fold.held_out])
    np.testing.assert_array_equal(np.sort(held_out), np.concatenate([part.time_s for part in parts]))


def test_what_is_learned_keeps_its_distance(parts: list[TorqueSamples]) -> None:
    for fold in folds(parts, blocks_of(parts)):
        held_out = np.concatenate([block.time_s for block in fold.held_out])
        learned = np.concatenate([block.time_s for block in fold.learned])
        distance_s = np.abs(learned[:, None] - held_out[None, :]).min(axis=1)
        assert distance_s.min() > gap_s(parts)
        # Gaps cost something, not most of it.
        assert len(learned) > 0.6 * (sum(map(len, parts)) - len(held_out))


def test_the_distance_is_more_than_the_filter_reaches(parts: list[TorqueSamples]) -> None:
    assert gap_s(parts) >= 2.0 / min(part.bandwidth_hz for part in parts)


def test_no_block_reaches_across_a_break(parts: list[TorqueSamples]) -> None:
    blocks = blocks_of(parts)
    assert {block.part for block in blocks} == {0, 1}
    for block in blocks:
        assert 0 <= block.start < block.end <= len(parts[block.part])


def test_a_recording_that_is_too_short_is_refused_with_its_length() -> None:
    parts = torque_samples(made_up(2.0, 100.0).recording)
    with pytest.raises(TrainingError, match=r"1\.\d+ s in 1 unbroken parts.*at least 5.*Record longer"):
        blocks_of(parts)


def test_nothing_at_all_is_refused_too() -> None:
    with pytest.raises(TrainingError, match="0 s in 0 unbroken parts"):
        blocks_of([])
