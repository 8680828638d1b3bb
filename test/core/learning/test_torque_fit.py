"""Torque learned from recordings, and judged by blocks of time that were held out."""

from __future__ import annotations

import numpy as np
import pytest
from made_up_recording import JOINTS, made_up, torque_nm

from tel_ros.core.config import LearningConfig
from tel_ros.core.errors import TrainingError
from tel_ros.core.learning.inputs import InputRange
from tel_ros.core.learning.learner import Learner, LearnerContext
from tel_ros.core.learning.least_squares_learner import LeastSquaresLearner
from tel_ros.core.learning.torque_fit import (
    N_FOLDS,
    Fit,
    TorquePrediction,
    blocks_of,
    fit_torque,
    folds,
    gap_s,
    held_out_error,
    predict_torque,
)
from tel_ros.core.learning.torque_samples import TorqueSamples, torque_samples
from tel_ros.core.types import FloatArray

LEARNING = LearningConfig(weights="least_squares", max_subtrees=1, detect_change=False)


def new_tree(input_range: InputRange, unit_nm: FloatArray, std_factor: FloatArray) -> Learner:
    return LeastSquaresLearner(
        LearnerContext(
            joints=JOINTS,
            stiffness_nm_per_rad=tuple(unit_nm),
            damping_nms_per_rad=(0.0, 0.0),
            input_range=input_range,
            learning=LEARNING,
            seed=1,
            predicts="torque",
            std_factor=tuple(std_factor),
        )
    )


@pytest.fixture(scope="module")
def parts() -> list[TorqueSamples]:
    """Half a minute of a rich movement."""
    return torque_samples(made_up(30.0, 50.0).recording)


@pytest.fixture(scope="module")
def fit(parts: list[TorqueSamples]) -> Fit:
    """A tree that has learned it."""
    return fit_torque(parts, new_tree)


def test_most_of_the_torque_that_was_held_out_is_predicted(fit: Fit, parts: list[TorqueSamples]) -> None:
    assert np.all(fit.held_out.nmse < 0.1)
    assert fit.held_out.n_samples == sum(map(len, parts))
    assert fit.n_blocks == len(blocks_of(parts)) > 10


def test_the_error_that_is_told_is_that_of_other_moments(fit: Fit, parts: list[TorqueSamples]) -> None:
    """At the same rate and place in the movement, half a minute later: none of it was learned."""
    later = torque_samples(made_up(60.0, 50.0, noise_nm=0.0).recording)[0][len(parts[0]) + 10 :]
    error = torque_nm(later.inputs) - predict_torque(fit.learner, later.inputs).torque_nm
    told, found = fit.held_out.rms_nm, np.sqrt(np.mean(error**2, axis=0))
    assert np.all(found < 3.0 * told)
    assert np.all(told < 3.0 * found)


def test_the_standard_deviation_has_the_size_of_held_out_errors(fit: Fit) -> None:
    np.testing.assert_allclose(fit.learner.context.std_factor, fit.held_out.std_factor)
    np.testing.assert_allclose(
        fit.held_out.std_factor * fit.held_out.expected_rms_nm, fit.held_out.rms_nm, rtol=1e-9
    )


def test_torque_that_has_nothing_to_do_with_the_motion_is_not_explained(parts: list[TorqueSamples]) -> None:
    rng = np.random.default_rng(2)
    noise = [
        TorqueSamples(**{**vars(part), "torque_nm": rng.normal(size=part.torque_nm.shape)}) for part in parts
    ]
    assert np.all(fit_torque(noise, new_tree).held_out.nmse > 0.9)


def test_a_movement_like_the_recorded_one_is_no_extrapolation(fit: Fit, parts: list[TorqueSamples]) -> None:
    assert not predict_torque(fit.learner, parts[0].inputs).outside.any()


def test_a_faster_movement_is_extrapolation(fit: Fit) -> None:
    """A slow recording cannot teach a fast movement: the tree is far off there, and says so."""
    fast = torque_samples(made_up(10.0, 125.0, speed=3.0).recording)[0]
    prediction = predict_torque(fit.learner, fast.inputs)
    error = held_out_error([(fast.torque_nm, prediction)])
    assert np.all(error.nmse > 5.0 * fit.held_out.nmse)
    assert error.extrapolated > 0.8
    outside = prediction.outside.mean(axis=0)
    assert np.all(outside[:2] < 0.1)  # it goes through the same positions
    assert np.all(outside[4:] > 0.3)


def test_torque_of_a_network_of_practice_follows_from_its_springs() -> None:
    class Known:
        context = LearnerContext(
            joints=JOINTS,
            stiffness_nm_per_rad=(10.0, 20.0),
            damping_nms_per_rad=(1.0, 2.0),
            input_range=InputRange(np.full(6, -1.0), np.full(6, 1.0)),
            learning=LEARNING,
            seed=1,
        )

        def predict(self, inputs: FloatArray) -> FloatArray:
            return np.full((len(inputs), 2), 0.1)

        def std(self, inputs: FloatArray) -> FloatArray:
            return np.tile([0.01, np.inf], (len(inputs), 1))

    inputs = np.zeros((3, 6))
    inputs[1, 2], inputs[2, 5] = 0.5, 1.5
    found = predict_torque(Known(), inputs)
    np.testing.assert_allclose(found.torque_nm, [[1.0, 2.0], [0.5, 2.0], [1.0, 2.0]])
    np.testing.assert_allclose(found.std_nm[:, 0], 0.1)
    assert found.outside.tolist()[2] == [False] * 5 + [True]
    assert found.uncertain.tolist() == [[False, True]] * 3
    assert found.extrapolated.all()


def test_shares_of_errors_are_counted() -> None:
    torque = np.array([[1.0], [-1.0], [1.0], [-1.0]])
    said = TorquePrediction(
        torque_nm=np.array([[1.0], [-1.0], [2.0], [-1.0]]),
        std_nm=np.full((4, 1), 0.25),
        outside=np.array([[False, False, True]] + [[False] * 3] * 3),
        uncertain=np.zeros((4, 1), dtype=bool),
    )
    found = held_out_error([(torque, said)])
    np.testing.assert_allclose(found.nmse, [0.25])
    np.testing.assert_allclose(found.rms_nm, [0.5])
    np.testing.assert_allclose(found.std_factor, [2.0])
    assert (found.within_2_std, found.extrapolated, found.n_samples) == (0.75, 0.25, 4)


@pytest.fixture(scope="module")
def broken() -> list[TorqueSamples]:
    """Two unbroken parts of a recording."""
    recording = made_up(40.0, 50.0).recording
    return torque_samples(recording[(recording.time_s < 15.0) | (recording.time_s > 16.0)])


def test_every_sample_is_held_out_once(broken: list[TorqueSamples]) -> None:
    assert len(broken) == 2
    found = folds(broken, blocks_of(broken))
    assert len(found) == N_FOLDS
    held_out = np.concatenate([block.time_s for fold in found for block in fold.held_out])
    np.testing.assert_array_equal(np.sort(held_out), np.concatenate([part.time_s for part in broken]))


def test_what_is_learned_keeps_its_distance(broken: list[TorqueSamples]) -> None:
    for fold in folds(broken, blocks_of(broken)):
        held_out = np.concatenate([block.time_s for block in fold.held_out])
        learned = np.concatenate([block.time_s for block in fold.learned])
        distance_s = np.abs(learned[:, None] - held_out[None, :]).min(axis=1)
        assert distance_s.min() > gap_s(broken)
        # Gaps cost something, not most of it.
        assert len(learned) > 0.6 * (sum(map(len, broken)) - len(held_out))


def test_the_distance_is_more_than_the_filter_reaches(broken: list[TorqueSamples]) -> None:
    assert gap_s(broken) >= 2.0 / min(part.bandwidth_hz for part in broken)


def test_no_block_reaches_across_a_break(broken: list[TorqueSamples]) -> None:
    blocks = blocks_of(broken)
    assert {block.part for block in blocks} == {0, 1}
    for block in blocks:
        assert 0 <= block.start < block.end <= len(broken[block.part])


def test_a_recording_that_is_too_short_is_refused_with_its_length() -> None:
    parts = torque_samples(made_up(2.0, 100.0).recording)
    with pytest.raises(TrainingError, match=r"1\.\d+ s in 1 unbroken part,.*at least 5.*Record longer"):
        blocks_of(parts)


def test_nothing_at_all_is_refused_too() -> None:
    with pytest.raises(TrainingError, match="0 s in 0 unbroken parts"):
        blocks_of([])
