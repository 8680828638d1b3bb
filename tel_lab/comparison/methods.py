"""The methods of ``tel compare``: what each is called, what it is told, and how it comes into being."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
import yaml

from tel_lab.comparison import servo_methods as servos
from tel_lab.comparison.servo_methods import Method
from tel_lab.comparison.stored_command import (
    IterativeLearningControl,
    StoredCommand,
    VirtualTrajectoryLearning,
)
from tel_lab.exact_model import ExactInverseDynamics
from tel_ros.core.config import Config
from tel_ros.core.config_fields import read_record
from tel_ros.core.errors import ConfigError
from tel_ros.core.trajectories.trajectory import DesiredTrajectory, sample
from tel_ros.recording.network_file import new_network
from tel_ros.recording.waypoint_file import load_path


@dataclass(frozen=True)
class MethodSpec:
    """A method of the comparison; ``methods.yaml`` says what the values are."""

    name: str
    title: str
    note: str
    given: Literal["nothing", "kinematics", "model"] = "nothing"
    settings: dict[str, Any] = field(default_factory=dict)
    commands: str = ""
    stiffer: tuple[float, float] = (1.0, 1.0)

    def make(self, config: Config) -> Method | None:
        """Return the method for one arm; None: the configured practice strategy and learner."""
        return MAKERS[self.commands](config) if self.commands else None


METHODS: dict[str, MethodSpec] = {
    name: read_record(MethodSpec, {"name": name, **values}, lambda key: "methods.yaml")
    for name, values in yaml.safe_load(Path(__file__).with_name("methods.yaml").read_text("utf-8")).items()
}
"""All methods by name."""


def chosen(names: Sequence[str]) -> list[MethodSpec]:
    """Return methods by name in the order of :data:`METHODS`; all if no name is given.

    Raises:
        ConfigError: there is no such method.
    """
    for name in names:
        if name not in METHODS:
            raise ConfigError("--methods", name, f"some of {', '.join(METHODS)}")
    return [spec for name, spec in METHODS.items() if not names or name in names]


def goal_movement(config: Config) -> DesiredTrajectory:
    path = load_path(config.path, config.arm)
    return sample(path, config.practice.goal_duration_s, config.control.rate_hz)


def _stored(kind: type[StoredCommand], config: Config) -> Method:
    """Return a command that is corrected from trial to trial, and begins as that of the usual servo."""
    desired, arm = goal_movement(config), config.arm
    damping_s = np.array(arm.damping_nms_per_rad) / np.array(arm.stiffness_nm_per_rad)
    initial_rad = servos.with_velocity_reference(desired, damping_s)
    return kind(desired, initial_rad, 1.0 / config.control.rate_hz)


MAKERS: dict[str, Callable[[Config], Method]] = {
    "servo": lambda config: servos.servo(1.0 / config.control.rate_hz),
    "exact": lambda config: servos.Feedforward(
        ExactInverseDynamics(config, config.sim).predict, 1.0 / config.control.rate_hz
    ),
    "feedback_error": lambda config: servos.FeedbackErrorLearning(
        new_network(config), 1.0 / config.control.rate_hz
    ),
    "iterative_learning": lambda config: _stored(IterativeLearningControl, config),
    "virtual_trajectory": lambda config: _stored(VirtualTrajectoryLearning, config),
}
"""Where ``commands`` of a method come from, for one arm."""
