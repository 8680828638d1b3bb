"""What every learner promises, whatever its kind."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pytest
from every_learner import (
    DURATIONS_S,
    INPUTS,
    MODES,
    assert_same_answers,
    new,
    noisy,
    restored,
    stored_copy,
    trained,
    trained_before,
    trials,
)
from two_link_trials import random_movement, trial, truth_rad  # noqa: E402

from tel_ros.core.config import LearningConfig  # noqa: E402
from tel_ros.core.learning.inputs import InputRange  # noqa: E402
from tel_ros.core.learning.learner import Learner, LearnerContext, TrainingMode, rms  # noqa: E402
from tel_ros.core.learning.registry import learner_kind  # noqa: E402
from tel_ros.core.learning.signals import TrainingSamples  # noqa: E402
from tel_ros.recording.network_file import load_network, save_network  # noqa: E402


def test_an_untrained_learner_says_zero_and_that_it_knows_nothing(options: dict[str, object]) -> None:
    learner = new(options)
    assert learner.trials_learned == 0
    assert learner.subtrees == (0, 0)
    np.testing.assert_array_equal(learner.predict(INPUTS), np.zeros((len(INPUTS), 2)))
    np.testing.assert_array_equal(learner.std(INPUTS), np.full((len(INPUTS), 2), np.inf))


def test_a_trained_learner_gives_each_joint_an_offset_and_a_finite_uncertainty(
    options: dict[str, object],
) -> None:
    learner = trained_before(options)
    for answer in (learner.predict(INPUTS), learner.std(INPUTS)):
        assert answer.shape == (len(INPUTS), 2)
        assert answer.dtype == np.float64
        assert np.all(np.isfinite(answer))
    assert np.all(learner.std(INPUTS) > 0.0)


def test_after_its_first_trial_a_learner_has_a_finite_uncertainty(options: dict[str, object]) -> None:
    learner, _ = new(options).trained_on(next(trials()), "actual")
    std = learner.std(INPUTS)
    assert np.all(np.isfinite(std))
    assert np.all(std > 0.0)


def test_a_single_input_can_be_asked_for(options: dict[str, object]) -> None:
    for learner in (new(options), trained_before(options)):
        assert learner.predict(INPUTS[:1]).shape == (1, 2)
        assert learner.std(INPUTS[:1]).shape == (1, 2)
        # One at a time or together: sums in another order.
        np.testing.assert_allclose(learner.predict(INPUTS[:1]), learner.predict(INPUTS)[:1], rtol=1e-9)


def test_asking_changes_nothing_and_spoils_no_inputs(options: dict[str, object]) -> None:
    learner, inputs = trained_before(options), INPUTS.copy()
    before, first, std = stored_copy(learner), learner.predict(inputs), learner.std(inputs)
    np.testing.assert_array_equal(learner.predict(inputs), first)
    np.testing.assert_array_equal(learner.std(inputs), std)
    np.testing.assert_array_equal(inputs, INPUTS)
    for name, array in learner.stored().arrays.items():
        np.testing.assert_array_equal(array, before[name])


@pytest.mark.parametrize("mode", MODES)
def test_training_returns_another_learner_and_leaves_the_old_one_bit_by_bit(
    options: dict[str, object], mode: TrainingMode
) -> None:
    old = trained_before(options)
    kept, header = stored_copy(old), dict(old.stored().header)
    answers, std = old.predict(INPUTS), old.std(INPUTS)
    newer, _ = old.trained_on(noisy(trial(4.0, step=20), 9), mode)
    assert newer.trials_learned == old.trials_learned + 1 == len(DURATIONS_S) + 1
    assert not np.array_equal(newer.predict(INPUTS), answers)
    np.testing.assert_array_equal(old.predict(INPUTS), answers)
    np.testing.assert_array_equal(old.std(INPUTS), std)
    assert dict(old.stored().header) == header
    assert old.stored().arrays.keys() == kept.keys()
    for name, array in old.stored().arrays.items():
        np.testing.assert_array_equal(array, kept[name])


def test_training_leaves_the_samples_as_they_were(options: dict[str, object]) -> None:
    samples, same = next(trials()), next(trials())
    for mode in MODES:
        new(options).trained_on(samples, mode)
    for name in ("actual", "desired", "offset_rad"):
        np.testing.assert_array_equal(getattr(samples, name), getattr(same, name))


@pytest.mark.parametrize("mode", MODES)
def test_training_reduces_the_error_at_points_of_the_movement_that_were_held_out(
    options: dict[str, object], mode: TrainingMode
) -> None:
    """Assumption A3 of [Practice]; its convergence theorems rest on it."""
    learner, held_out = new(options), trial(step=20, first=10)
    errors = [rms(held_out.offset_rad)]
    for seed in range(3):
        learner, _ = learner.trained_on(noisy(trial(step=20), seed), mode)
        errors.append(rms(held_out.offset_rad - learner.predict(held_out.actual)))
    assert errors[1] < 0.5 * errors[0]
    assert errors[3] < 0.3 * errors[0]


def test_desired_mode_learns_at_the_desired_trajectory_what_was_wrong_at_the_actual_one(
    options: dict[str, object],
) -> None:
    learner, _ = new(options).trained_on(next(trials()), "actual")
    samples = noisy(trial(4.5, step=20, shift_rad=0.3), 9)
    target = learner.predict(samples.desired) + samples.offset_rad - learner.predict(samples.actual)
    same = dataclasses.replace(samples, actual=samples.desired, offset_rad=target)
    one, other = learner.trained_on(samples, "desired")[0], learner.trained_on(same, "actual")[0]
    np.testing.assert_array_equal(one.predict(INPUTS), other.predict(INPUTS))
    assert not np.array_equal(learner.trained_on(samples, "actual")[0].predict(INPUTS), one.predict(INPUTS))


def test_the_outcome_reports_what_training_did(options: dict[str, object]) -> None:
    old = new(options)
    for samples in (next(trials()), noisy(trial(4.0, step=20, shift_rad=0.05), 9)):
        learner, outcome = old.trained_on(samples, "actual")
        before, after = old.predict(samples.actual), learner.predict(samples.actual)
        assert outcome.training_rms_before_rad == pytest.approx(rms(samples.offset_rad - before))
        assert outcome.training_rms_after_rad == pytest.approx(rms(samples.offset_rad - after))
        change = learner.predict(samples.desired) - old.predict(samples.desired)
        assert outcome.rms_command_change_rad == pytest.approx(rms(change))
        assert outcome.training_rms_after_rad < outcome.training_rms_before_rad
        assert all(isinstance(text, str) for text in outcome.grown)
        old = learner


def test_equal_samples_and_seeds_give_bit_identical_learners(options: dict[str, object]) -> None:
    one, other = (trained(new(options, seed=3)) for _ in range(2))
    np.testing.assert_array_equal(one.predict(INPUTS), other.predict(INPUTS))
    np.testing.assert_array_equal(one.std(INPUTS), other.std(INPUTS))
    again = other.stored()
    assert dict(one.stored().header) == dict(again.header)
    for name, array in one.stored().arrays.items():
        np.testing.assert_array_equal(array, again.arrays[name])


@pytest.mark.parametrize("n_trials", [0, 1, 3])
def test_a_restored_learner_gives_the_same_answers(options: dict[str, object], n_trials: int) -> None:
    learner = new(options)
    for _, samples in zip(range(n_trials), trials(), strict=False):
        learner, _ = learner.trained_on(samples, "actual")
    assert learner.trials_learned == n_trials
    assert_same_answers(restored(learner), learner)


@pytest.mark.parametrize("change", [{"forgetting": 0.8}, {"memory_samples": 1000}], ids=str)
def test_a_learner_that_forgets_or_thins_out_comes_back_as_well(
    options: dict[str, object], change: dict[str, object]
) -> None:
    learner = new(options, **change)
    for seed in range(3):
        learner, _ = learner.trained_on(noisy(trial(4.5 + seed, step=8), seed), "actual")
    assert_same_answers(restored(learner), learner)


@pytest.mark.parametrize(
    ("mode", "change"),
    [("actual", {}), ("desired", {}), ("actual", {"forgetting": 0.8}), ("actual", {"memory_samples": 1000})],
    ids=str,
)
def test_a_restored_learner_goes_on_training_bit_by_bit_as_if_it_had_never_been_stored(
    options: dict[str, object], mode: TrainingMode, change: dict[str, object]
) -> None:
    """A run that was interrupted goes on with a network from its file, and ends as it would have without."""
    kept = back = new(options, **change)
    for seed, duration_s in enumerate((7.0, 5.5, 4.5, 4.0)):
        samples = noisy(trial(duration_s, step=8 if change else 20), seed)
        kept, kept_said = kept.trained_on(samples, mode)
        back, back_said = restored(back).trained_on(samples, mode)
        assert back_said == kept_said
        assert_same_answers(back, kept)
        for name, array in kept.stored().arrays.items():
            np.testing.assert_array_equal(back.stored().arrays[name], array)


@pytest.mark.parametrize("learn", [lambda learner: learner, trained], ids=["untrained", "trained"])
def test_a_learner_comes_back_from_its_file(
    options: dict[str, object], learn: Callable[[Learner], Learner], tmp_path: Path
) -> None:
    learner = learn(new(options))
    save_network(learner, tmp_path / "network.npz")
    loaded = load_network(tmp_path / "network.npz")
    assert type(loaded) is type(learner)
    assert_same_answers(loaded, learner)
    told, known = loaded.context, learner.context
    for key in ("joints", "stiffness_nm_per_rad", "damping_nms_per_rad", "learning", "seed", "urdf"):
        assert getattr(told, key) == getattr(known, key)
    np.testing.assert_array_equal(told.input_range.low, known.input_range.low)
    np.testing.assert_array_equal(told.input_range.high, known.input_range.high)


def seven_joints(options: Mapping[str, object]) -> tuple[LearnerContext, Callable[[int], TrainingSamples]]:
    """Return an arm of seven joints in the field of gravity, and movements of it by number."""
    pinocchio = pytest.importorskip("pinocchio")
    data = pytest.importorskip("pybullet_data")
    urdf = (Path(data.getDataPath()) / "kuka_iiwa" / "model.urdf").read_text(encoding="utf-8")
    model = pinocchio.buildModelFromXML(urdf)
    record = model.createData()

    def movement(number: int) -> TrainingSamples:
        rng = np.random.default_rng(number)
        parts = [random_movement(rng, 4.0) for _ in range(4)]
        q, v, a = (np.hstack([part[:, 2 * k : 2 * k + 2] for part in parts])[:, :7] for k in range(3))
        torque = np.array([pinocchio.rnea(model, record, *row) for row in zip(q, v, a, strict=True)])
        inputs = np.hstack([q, v, a])
        return TrainingSamples(actual=inputs, desired=inputs, offset_rad=(torque + v) / 200.0)

    told = LearnerContext(
        joints=tuple(f"lbr_iiwa_joint_{k + 1}" for k in range(7)),
        stiffness_nm_per_rad=(200.0,) * 7,
        damping_nms_per_rad=(1.0,) * 7,
        input_range=InputRange(np.repeat([-0.5, -2.0, -6.0], 7), np.repeat([2.2, 2.0, 6.0], 7)),
        learning=LearningConfig(**{**options, "gaussians_per_input": 4}),
        seed=1,
        urdf=urdf,
    )
    return told, movement


def test_an_arm_of_seven_joints_is_learned(options: dict[str, object], tmp_path: Path) -> None:
    told, movement = seven_joints(options)
    learner = learner_kind(told.learning.name).new(told)
    held_out = movement(0)
    held_out, learned = (
        dataclasses.replace(
            held_out,
            actual=held_out.actual[first::2],
            desired=held_out.desired[first::2],
            offset_rad=held_out.offset_rad[first::2],
        )
        for first in (0, 1)
    )
    for samples in (movement(1), learned):
        learner, _ = learner.trained_on(samples, "actual")
    answer = learner.predict(held_out.actual)
    assert answer.shape == learner.std(held_out.actual).shape == held_out.offset_rad.shape
    assert rms(held_out.offset_rad - answer) < 0.3 * rms(held_out.offset_rad)
    save_network(learner, tmp_path / "network.npz")
    assert_same_answers(load_network(tmp_path / "network.npz"), learner, held_out.actual)


def test_what_was_learned_is_the_truth_of_the_arm(options: dict[str, object]) -> None:
    """Beside the test on the samples: the formula of the arm, at other speeds between those learned."""
    learner = trained_before(options)
    inputs = trial(6.0, step=25).actual
    assert rms(truth_rad(inputs) - learner.predict(inputs)) < 0.4 * rms(truth_rad(inputs))
