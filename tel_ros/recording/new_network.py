"""The learner that a practice run begins with."""

from __future__ import annotations

from pathlib import Path

from tel_ros.core.config import Config
from tel_ros.core.errors import ConfigError
from tel_ros.core.learning.inputs import InputRange
from tel_ros.core.learning.learner import Learner, LearnerContext
from tel_ros.core.trajectories.sampling import sample
from tel_ros.recording.learners import learner_kind
from tel_ros.recording.waypoint_file import load_path


def learner_context(config: Config) -> LearnerContext:
    """Return what a learner is told: among it, input ranges that cover the goal movement."""
    path = load_path(config.path, config.arm)
    goal = sample(path, config.practice.goal_duration_s, config.control.rate_hz)
    return LearnerContext(
        joints=config.arm.joints,
        stiffness_nm_per_rad=config.arm.stiffness_nm_per_rad,
        damping_nms_per_rad=config.arm.damping_nms_per_rad,
        input_range=InputRange.covering(goal, config.learning.input_margin),
        learning=config.learning,
        seed=config.seed,
        urdf=Path(config.arm.urdf).read_text(encoding="utf-8"),
    )


def new_network(config: Config) -> Learner:
    """Return the untrained learner that a configuration asks for.

    Raises:
        ConfigError: there is no such learner, or it cannot do what is asked.
    """
    try:
        return learner_kind(config.learning.name).new(learner_context(config))
    except ConfigError as error:
        raise error if error.key.startswith("learning.") else error.inside("learning") from None
