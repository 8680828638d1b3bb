"""What every learner promises, whatever its kind."""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Callable, Iterator, Mapping
from functools import cache
from itertools import product
from pathlib import Path

import numpy as np
import pytest

for folder in ("learning", "."):
    sys.path.insert(0, str(Path(__file__).parents[1] / "core" / folder))

from two_link_trials import GOAL, context, random_movement, trial, truth_rad  # noqa: E402

from tel_ros.core.config import LearningConfig  # noqa: E402
from tel_ros.core.errors import NetworkFileError, TrainingError  # noqa: E402
from tel_ros.core.learning.inputs import InputRange, query_inputs  # noqa: E402
from tel_ros.core.learning.learner import Learner, LearnerContext, StoredLearner, TrainingMode, rms  # noqa: E402
from tel_ros.core.learning.registry import learner_kind  # noqa: E402
from tel_ros.core.learning.signals import TrainingSamples  # noqa: E402
from tel_ros.recording.network_file import load_network, save_network  # noqa: E402

LEARNERS = {
    "lms_tree, lms": {"name": "lms_tree", "weights": "lms"},
    "lms_tree, least_squares": {"name": "lms_tree", "weights": "least_squares"},
    "rigid_body": {"name": "rigid_body"},
    "rigid_body+lms_tree": {"name": "rigid_body+lms_tree"},
}
MODES: tuple[TrainingMode, ...] = ("actual", "desired")
DURATIONS_S = (7.0, 5.5, 4.5)
INPUTS = query_inputs(GOAL, 0.002)[3::50]
NOISE_RAD = 1e-3


@pytest.fixture(params=list(LEARNERS.values()), ids=list(LEARNERS))
def options(request: pytest.FixtureRequest) -> dict[str, object]:
    """One kind of learner, with trees that are small so that they are quick."""
    if "rigid_body" in request.param["name"]:
        pytest.importorskip("pinocchio")
    return {"gaussians_per_input": 6} | request.param


def new(options: Mapping[str, object], seed: int = 1, **learning: object) -> Learner:
    told = context(seed, **{**options, **learning})
    return learner_kind(told.learning.name).new(told)


def noisy(samples: TrainingSamples, seed: int) -> TrainingSamples:
    """Return samples with the noise of commands, without which some learners are right at once."""
    noise = NOISE_RAD * np.random.default_rng(seed).normal(size=samples.offset_rad.shape)
    return dataclasses.replace(samples, offset_rad=samples.offset_rad + noise)


def trials() -> Iterator[TrainingSamples]:
    for seed, duration_s in enumerate(DURATIONS_S):
        yield noisy(trial(duration_s, step=20), seed)


def trained(learner: Learner, mode: TrainingMode = "actual") -> Learner:
    for samples in trials():
        learner, _ = learner.trained_on(samples, mode)
    return learner


@cache
def _trained(**options: object) -> Learner:
    return trained(new(options))


def trained_before(options: Mapping[str, object]) -> Learner:
    """Return a trained learner of a kind; it is a value, which no test can change."""
    return _trained(**options)


def restored(learner: Learner) -> Learner:
    kind = learner_kind(learner.context.learning.name)
    return kind.restored(learner.context, learner.stored())


def stored_copy(learner: Learner) -> dict[str, np.ndarray]:
    return {name: array.copy() for name, array in learner.stored().arrays.items()}


def assert_same_answers(one: Learner, other: Learner, inputs: np.ndarray = INPUTS) -> None:
    np.testing.assert_array_equal(one.predict(inputs), other.predict(inputs))
    np.testing.assert_array_equal(one.std(inputs), other.std(inputs))
    assert (one.trials_learned, one.subtrees) == (other.trials_learned, other.subtrees)


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
        assert outcome.rms_before_rad == pytest.approx(rms(samples.offset_rad - before))
        assert outcome.rms_after_rad == pytest.approx(rms(samples.offset_rad - after))
        change = learner.predict(samples.desired) - old.predict(samples.desired)
        assert outcome.rms_command_change_rad == pytest.approx(rms(change))
        assert outcome.rms_after_rad < outcome.rms_before_rad
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


@dataclasses.dataclass(frozen=True)
class Damaged(Learner):
    """A learner that is stored in another state than its own."""

    context: LearnerContext
    state: StoredLearner

    def stored(self) -> StoredLearner:
        return self.state


@pytest.fixture
def learner(options: dict[str, object]) -> Learner:
    """A trained learner of each kind."""
    return trained_before(options)


def accepted(learner: Learner, states: Mapping[str, StoredLearner], folder: Path) -> dict[str, str]:
    """Return which of some states, all damaged, are not refused as they should be, and what happened.

    A learner refuses a state by a ValueError, and a reader of files by an error that names the file.
    """
    kind, found = learner_kind(learner.context.learning.name), {}
    for name, state in states.items():
        try:
            kind.restored(learner.context, state)
            found[name] = "restored"
        except ValueError:
            pass
        except Exception as error:
            found[name] = repr(error)
        path = folder / f"{name}.npz"
        save_network(Damaged(learner.context, state), path)
        with pytest.raises(NetworkFileError, match=r"; expected ") as refused:
            load_network(path)
        assert str(refused.value).startswith(f"{path}: ")
    return found


def with_array(state: StoredLearner, name: str, array: np.ndarray) -> StoredLearner:
    return StoredLearner(state.header, {**state.arrays, name: array})


def test_a_state_without_one_of_its_arrays_is_refused(learner: Learner, tmp_path: Path) -> None:
    """Apart from one that files from before did not have."""
    state = learner.stored()
    states = {
        name: StoredLearner(state.header, {k: array for k, array in state.arrays.items() if k != name})
        for name in state.arrays
        if name != "memory_trust"
    }
    assert accepted(learner, states, tmp_path) == {}


def test_a_state_without_one_of_its_header_values_is_refused(learner: Learner, tmp_path: Path) -> None:
    state = learner.stored()
    states = {
        name: StoredLearner({k: value for k, value in state.header.items() if k != name}, state.arrays)
        for name in state.header
    }
    assert accepted(learner, states, tmp_path) == {}


@pytest.mark.parametrize("shape", ["longer", "flat", "empty"])
def test_an_array_of_a_wrong_shape_is_refused(learner: Learner, shape: str, tmp_path: Path) -> None:
    state = learner.stored()
    changed = {
        "longer": lambda array: np.concatenate([array, array[:1]]),
        "flat": np.ravel,
        "empty": lambda array: np.empty(0),
    }[shape]
    states = {
        name: with_array(state, name, changed(array))
        for name, array in state.arrays.items()
        if array.shape != changed(array).shape
        and array.size
        # Empty, it stands for the calibration of an untrained learner.
        and not (shape == "empty" and "calibration" in name)
    }
    assert states
    assert accepted(learner, states, tmp_path) == {}


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_numbers_that_are_not_finite_are_refused(learner: Learner, bad: float, tmp_path: Path) -> None:
    state, states = learner.stored(), {}
    for name, array in state.arrays.items():
        if np.issubdtype(array.dtype, np.floating) and array.size:
            damaged = array.copy()
            damaged.flat[-1] = bad
            states[name] = with_array(state, name, damaged)
    assert states
    assert accepted(learner, states, tmp_path) == {}


def test_the_strength_of_a_prior_that_is_not_above_zero_is_refused(learner: Learner, tmp_path: Path) -> None:
    """With such a strength, making an indefinite matrix regular by raising it would never end."""
    state, states = learner.stored(), {}
    for bad in (np.nan, -1.0, 0.0):
        for key, value in (("prior_strength", bad), ("prior_strengths", [1.0, bad])):
            if key in state.header:
                states[f"{key} {bad}"] = StoredLearner({**state.header, key: value}, state.arrays)
    for damaged in states.values():
        with pytest.raises(ValueError, match="strength"):
            learner_kind(learner.context.learning.name).restored(learner.context, damaged)


@pytest.mark.parametrize("name", ["lms_tree, lms", "lms_tree, least_squares", "rigid_body+lms_tree"])
def test_a_subtree_under_a_leaf_that_is_not_there_is_refused(name: str, tmp_path: Path) -> None:
    if "rigid_body" in name:
        pytest.importorskip("pinocchio")
    learner = trained(new({**LEARNERS[name], "gaussians_per_input": 6, "growth_per_trial": 0}))
    state = learner.stored()
    sizes = {key: np.zeros((2, 6, 6)) for key in ("weights_1", "seen_1") if key in state.arrays}

    def hung_under(*leaf: object) -> StoredLearner:
        return StoredLearner(state.header, {**state.arrays, **sizes, "parents_1": np.array(leaf)})

    learner_kind(learner.context.learning.name).restored(learner.context, hung_under([0, 5, 5]))
    leaves = [[1, 0, 0], [-1, 0, 0], [0, 6, 0], [0, -1, 0], [0, 0, 6], [0, 0, -1], [0, 0], 0]
    assert accepted(learner, {str(leaf): hung_under(leaf) for leaf in leaves}, tmp_path) == {}


def test_samples_that_are_not_finite_are_refused_and_nothing_is_learned(options: dict[str, object]) -> None:
    learner, samples = trained_before(options), next(trials())
    answers, kept = learner.predict(INPUTS), stored_copy(learner)
    for name, bad, mode in product(("actual", "desired", "offset_rad"), (np.nan, np.inf), MODES):
        values = getattr(samples, name).copy()
        values[3, 1] = bad
        for one in (learner, new(options)):
            with np.errstate(all="ignore"), pytest.raises(TrainingError, match="finite"):
                one.trained_on(dataclasses.replace(samples, **{name: values}), mode)
    np.testing.assert_array_equal(learner.predict(INPUTS), answers)
    assert learner.trials_learned == len(DURATIONS_S)
    for key, array in learner.stored().arrays.items():
        np.testing.assert_array_equal(array, kept[key])


@pytest.mark.parametrize("absurd", [1e155, 1e308])
def test_finite_samples_whose_errors_have_no_finite_size_are_refused(
    options: dict[str, object], absurd: float
) -> None:
    samples = next(trials())
    samples.offset_rad[3] = absurd
    with np.errstate(all="ignore"), pytest.raises(TrainingError, match="finite"):
        new(options).trained_on(samples, "actual")


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
