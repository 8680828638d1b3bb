"""The methods of ``tel compare``: what each is called, what it is told, and how it comes into being."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
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
from tel_lab.time_bound import Model, time_bound
from tel_ros.core.config import Config
from tel_ros.core.config_fields import read_record
from tel_ros.core.errors import ConfigError
from tel_ros.core.practice.learned_timings import VELOCITY_SHARE
from tel_ros.core.trajectories.trajectory import DesiredTrajectory, sample
from tel_ros.core.types import NS_PER_S, FloatArray
from tel_ros.recording.network_file import new_network
from tel_ros.recording.waypoint_file import load_path

_REST_TICKS = 2


@dataclass(frozen=True)
class MethodSpec:
    """A method of the comparison; ``methods.yaml`` says what the values are."""

    name: str
    title: str
    note: str
    given: Literal["nothing", "kinematics", "urdf", "model"] = "nothing"
    settings: dict[str, Any] = field(default_factory=dict)
    commands: str = ""
    timing: Literal["", "urdf", "model"] = ""
    stiffer: tuple[float, float] = (1.0, 1.0)

    def make(self, config: Config) -> Method | None:
        """Return the method for one arm; None: the configured practice strategy and learner."""
        return MAKERS[self.commands](config) if self.commands else None

    @property
    def is_fastest(self) -> bool:
        """Whether it is to be as fast as the arm can, instead of as fast as configured."""
        return bool(self.timing) or self.settings.get("practice.goal") == "fastest"

    def movement(self, config: Config) -> DesiredTrajectory:
        """Return what it executes in every trial, unless it practises."""
        return fastest_movement(config, MODELS[self.timing](config)) if self.timing else goal_movement(config)


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


def exact_model(config: Config) -> Model:
    return ExactInverseDynamics(config, config.sim).predict


def urdf_model(config: Config) -> Model:
    """Return the inverse dynamics that the URDF describes, whatever has been made of the simulated arm."""
    friction = {"viscous_friction_nms_per_rad": (), "coulomb_friction_nm": ()}
    sim = replace(config.sim, inertia_scale=1.0, payload_kg=0.0, **friction)  # type: ignore[arg-type]
    return ExactInverseDynamics(config, sim).predict


def fastest_movement(config: Config, model: Model) -> DesiredTrajectory:
    """Return the movement that is time-optimal for a model of the arm, with the room that practice leaves.

    A few ticks of rest before and after it, since the controller holds the first and the last command.
    """
    path, arm = load_path(config.path, config.arm), config.arm
    slower = replace(arm, velocity_limit_rad_s=tuple(VELOCITY_SHARE * v for v in arm.velocity_limit_rad_s))
    timing = time_bound(slower, model, path, config.practice.effort_share)
    moving = sample(path, timing, config.control.rate_hz)
    n, ends = len(moving.time_ns) + 2 * _REST_TICKS, ((_REST_TICKS, _REST_TICKS), (0, 0))
    return DesiredTrajectory(
        np.round(np.arange(n) * (NS_PER_S / config.control.rate_hz)).astype(np.int64),
        np.pad(moving.position_rad, ends, mode="edge"),
        np.pad(moving.velocity_rad_s, ends),
        np.pad(moving.acceleration_rad_s2, ends),
    )


MODELS: dict[str, Callable[[Config], Model]] = {"urdf": urdf_model, "model": exact_model}


def _stored(kind: type[StoredCommand], config: Config) -> Method:
    """Return a command that is corrected from trial to trial, and begins as that of the usual servo."""
    desired = goal_movement(config)
    initial_rad = servos.with_velocity_reference(desired, _damping_s(config))
    return kind(desired, initial_rad, 1.0 / config.control.rate_hz)


def _damping_s(config: Config) -> FloatArray:
    """Return K⁻¹ B. Shape (n_joints,)."""
    return np.array(config.arm.damping_nms_per_rad) / np.array(config.arm.stiffness_nm_per_rad)


MAKERS: dict[str, Callable[[Config], Method]] = {
    "servo": lambda config: servos.servo(1.0 / config.control.rate_hz),
    "pd_servo": lambda config: servos.Feedforward(
        lambda inputs: _damping_s(config) * np.split(inputs, 3, axis=1)[1], 1.0 / config.control.rate_hz
    ),
    "exact": lambda config: servos.Feedforward(exact_model(config), 1.0 / config.control.rate_hz),
    "feedback_error": lambda config: servos.FeedbackErrorLearning(
        new_network(config), 1.0 / config.control.rate_hz
    ),
    "iterative_learning": lambda config: _stored(IterativeLearningControl, config),
    "virtual_trajectory": lambda config: _stored(VirtualTrajectoryLearning, config),
}
"""Where ``commands`` of a method come from, for one arm."""
