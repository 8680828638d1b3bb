"""Small networks to store and to spoil."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from tel_ros.core.config import LearningConfig
from tel_ros.core.errors import NetworkFileError
from tel_ros.core.learning.inputs import InputRange
from tel_ros.core.learning.learner import LearnerContext
from tel_ros.core.learning.lms_learner import LmsLearner
from tel_ros.core.learning.signals import TrainingSamples
from tel_ros.recording.network_file import load_network

X = np.random.default_rng(5).uniform(-2.0, 2.0, (30, 6))


def samples(seed: int) -> TrainingSamples:
    rng = np.random.default_rng(seed)
    x = rng.uniform(-2.0, 2.0, (60, 6))
    return TrainingSamples(actual=x, desired=x + 0.01, offset_rad=np.sin(x[:, :2] * x[:, 2:4]))


CONTEXT = LearnerContext(
    joints=("shoulder", "elbow"),
    stiffness_nm_per_rad=(15.0, 12.0),
    damping_nms_per_rad=(1.5, 0.0),
    input_range=InputRange(low=np.full(6, -2.1), high=np.linspace(2.1, 2.2, 6)),
    learning=LearningConfig(max_subtrees=4, growth_per_trial=2, rate=0.3, gaussians_per_input=6),
    seed=5,
    urdf='<robot name="straße"/>',
)


def trained(trials: int, **context: object) -> LmsLearner:
    network = LmsLearner(dataclasses.replace(CONTEXT, **context))
    for trial in range(trials):
        network, _ = network.trained_on(samples(trial), "actual")
    return network


def refusal(file: Path) -> str:
    with pytest.raises(NetworkFileError) as error:
        load_network(file)
    assert str(error.value).startswith(f"{file}: ")
    assert "; expected " in str(error.value)
    return str(error.value)
