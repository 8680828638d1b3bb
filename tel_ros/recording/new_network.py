"""The learner that a practice run begins with."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tel_ros.core.config import Config
from tel_ros.core.errors import ConfigError
from tel_ros.core.learning.inputs import InputRange
from tel_ros.core.learning.learner import Learner, LearnerContext
from tel_ros.core.learning.registry import learner_kind
from tel_ros.core.practice.movement_path import desired_trajectory
from tel_ros.core.practice.strategies import make_strategy
from tel_ros.recording.network_file import load_network
from tel_ros.recording.urdf import described, urdf_text
from tel_ros.recording.waypoint_file import load_known_path, load_path

PREDICTS_TORQUE = "a network of practice, which predicts equilibrium points; this one predicts torque"


def learner_context(config: Config) -> LearnerContext:
    """Return what a learner is told: among it, input ranges that cover all that practice may ask for."""
    path, known_path = load_path(config.path, config.arm), load_known_path(config.path, config.arm)
    ranges = [
        InputRange.covering(
            desired_trajectory(path, known_path, movement, config.control.rate_hz),
            config.learning.input_margin,
        )
        for movement in make_strategy(config).movements_to_cover()
    ]
    return LearnerContext(
        joints=config.arm.joints,
        stiffness_nm_per_rad=config.arm.stiffness_nm_per_rad,
        damping_nms_per_rad=config.arm.damping_nms_per_rad,
        input_range=InputRange(
            low=np.min([covered.low for covered in ranges], axis=0),
            high=np.max([covered.high for covered in ranges], axis=0),
        ),
        learning=config.learning,
        seed=config.seed,
        urdf=urdf_text(described(config.arm)),
    )


def new_network(config: Config) -> Learner:
    """Return the learner that a configuration asks for: an untrained one, or that of an earlier run.

    Raises ConfigError or, about the file of the earlier run, NetworkFileError.
    """
    if config.learning.start_from:
        return _earlier(config)
    try:
        return learner_kind(config.learning.name).new(learner_context(config))
    except ConfigError as error:
        raise error if error.key.startswith("learning.") else error.inside("learning") from None


def _earlier(config: Config) -> Learner:
    file, arm = config.learning.start_from, config.arm
    learner = load_network(Path(file))
    context = learner.context
    if context.predicts == "torque":
        raise ConfigError("learning.start_from", file, PREDICTS_TORQUE)
    for name, found, expected in (
        ("joints", context.joints, arm.joints),
        ("stiffness_nm_per_rad", context.stiffness_nm_per_rad, arm.stiffness_nm_per_rad),
        ("damping_nms_per_rad", context.damping_nms_per_rad, arm.damping_nms_per_rad),
    ):
        if found != expected:
            wanted = f"a network for {name} {list(expected)}, not {list(found)}"
            raise ConfigError("learning.start_from", file, wanted)
    return learner
