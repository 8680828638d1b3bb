"""The network that a practice run begins with."""

from __future__ import annotations

from tel_ros.core.config import Config
from tel_ros.core.learning.inputs import InputRange
from tel_ros.core.learning.inverse_dynamics import LmsTreeInverseDynamics
from tel_ros.core.trajectories.sampling import sample
from tel_ros.recording.waypoint_file import load_path


def new_network(config: Config) -> LmsTreeInverseDynamics:
    """Return an untrained network whose input ranges cover the goal movement."""
    path = load_path(config.path, config.arm)
    goal = sample(path, config.practice.goal_duration_s, config.control.rate_hz)
    input_range = InputRange.covering(goal, config.learning.input_margin)
    return LmsTreeInverseDynamics(config.arm.joints, input_range, config.learning, config.seed)
