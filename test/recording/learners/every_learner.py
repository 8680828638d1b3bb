"""Every kind of learner, and trials of an arm to teach them."""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path

import numpy as np

for folder in ("learning", "."):
    sys.path.insert(0, str(Path(__file__).parents[2] / "core" / folder))

from two_link_trials import GOAL, context, trial  # noqa: E402

from tel_ros.core.learning.inputs import query_inputs  # noqa: E402
from tel_ros.core.learning.learner import Learner, TrainingMode  # noqa: E402
from tel_ros.core.learning.registry import learner_kind  # noqa: E402
from tel_ros.core.learning.signals import TrainingSamples  # noqa: E402

LEARNERS = {
    "lms_tree, lms": {"name": "lms_tree", "weights": "lms"},
    "lms_tree, least_squares": {"name": "lms_tree", "weights": "least_squares"},
    "polynomial": {"name": "polynomial"},
    "rigid_body": {"name": "rigid_body"},
    "rigid_body+lms_tree": {"name": "rigid_body+lms_tree"},
}
MODES: tuple[TrainingMode, ...] = ("actual", "desired")
DURATIONS_S = (7.0, 5.5, 4.5)
INPUTS = query_inputs(GOAL, 0.002)[3::50]
NOISE_RAD = 1e-3


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
