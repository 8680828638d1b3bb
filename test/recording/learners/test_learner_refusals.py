"""What a learner refuses: states that are damaged, and samples that nothing can be learned from."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from every_learner import (
    DURATIONS_S,
    INPUTS,
    LEARNERS,
    MODES,
    new,
    stored_copy,
    trained,
    trained_before,
    trials,
)

from tel_ros.core.errors import ConfigError, NetworkFileError, TrainingError  # noqa: E402
from tel_ros.core.learning.learner import Learner, LearnerContext, StoredLearner  # noqa: E402
from tel_ros.core.learning.registry import learner_kind  # noqa: E402
from tel_ros.recording.config_file import load_config
from tel_ros.recording.network_file import load_network, new_network, save_network  # noqa: E402
from tel_ros.recording.shared_files import named_config  # noqa: E402


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
    """Apart from those that files from before did not have."""
    state = learner.stored()
    states = {
        name: StoredLearner(state.header, {k: array for k, array in state.arrays.items() if k != name})
        for name in state.arrays
        if name not in ("memory_trust", "prior_shape")
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


@pytest.mark.parametrize("name", ["lms_tree", "rigid_body+lms_tree"])
def test_the_fastest_movement_is_not_asked_of_a_learner_that_knows_only_speeds_it_has_seen(name: str) -> None:
    overrides = [f"learning.name={name}", "practice.goal=fastest", "practice.strategy=adaptive_extension"]
    config = load_config(named_config("planar_arm"), overrides)
    with pytest.raises(
        ConfigError, match=f"learning.name is '{re.escape(name)}'; expected polynomial or rigid_body"
    ):
        new_network(config)
