"""From a movement to its trajectory and its command, and from a prediction to a forecast."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tel_ros.core.config import ArmConfig
from tel_ros.core.errors import ConfigError
from tel_ros.core.practice.strategy import Forecast, Movement
from tel_ros.core.springs import Springs
from tel_ros.core.trajectories.paths import Path, blended, part, scaled
from tel_ros.core.trajectories.trajectory import DesiredTrajectory, sample
from tel_ros.core.types import FloatArray

_FORECAST_POINTS = 200


def movement_path(goal: Path, known: Path | None, movement: Movement) -> Path:
    """Return the path of a movement: blended, then scaled, then cut. The goal itself if nothing varies.

    Args:
        goal: the configured path.
        known: the path at shape 0; None if there is none.
        movement: what to vary, and how far.

    Raises:
        ConfigError: the shape varies, and no path is known.
    """
    path = goal
    if movement.shape != 1.0:
        if known is None:
            raise ConfigError("path.known_name", "", "a known path (or known_file), because shape is varied")
        path = blended(known, path, movement.shape)
    if movement.amplitude != 1.0:
        path = scaled(path, movement.amplitude)
    if not movement.is_whole:
        path = part(path, movement.start, movement.end)
    return path


def desired_trajectory(
    goal: Path, known: Path | None, movement: Movement, rate_hz: float
) -> DesiredTrajectory:
    """Return the trajectory of a movement, from rest to rest, with ``rate_hz`` points a second.

    Raises:
        ConfigError: the shape varies, and no path is known.
    """
    return sample(movement_path(goal, known, movement), movement.own_duration_s, rate_hz)


def forecast_trajectory(goal: Path, known: Path | None, movement: Movement) -> DesiredTrajectory:
    """Return the trajectory to ask the learner about: coarse, with equally many points at any speed.

    Raises:
        ConfigError: the shape varies, and no path is known.
    """
    return desired_trajectory(goal, known, movement, _FORECAST_POINTS / movement.own_duration_s)


def forecast_of(
    desired: DesiredTrajectory,
    equilibrium_rad: FloatArray,
    std_rad: FloatArray,
    arm: ArmConfig,
    movement: Movement,
) -> Forecast:
    """Return a forecast from a prediction: following y exactly takes τ = K (û - y) - B ẏ.

    Args:
        desired: y, as asked about.
        equilibrium_rad: û. Shape (n, n_joints).
        std_rad: its standard deviation. Shape (n, n_joints).
        arm: K and B that the prediction is for.
        movement: stiffer springs turn the same error in the effort into a smaller deviation.
    """
    stiffness, damping = np.array(arm.stiffness_nm_per_rad), np.array(arm.damping_nms_per_rad)
    offset_rad = equilibrium_rad - desired.position_rad
    return Forecast(std_rad / movement.stiffness, stiffness * offset_rad - damping * desired.velocity_rad_s)


class Command(NamedTuple):
    """The springs of one trial (None: as configured) and û for them. Shape (n, n_joints)."""

    springs: Springs | None
    equilibrium_rad: FloatArray


def command(
    arm: ArmConfig, movement: Movement, desired: DesiredTrajectory, equilibrium_rad: FloatArray
) -> Command:
    """Return the command for the springs of a movement.

    Args:
        arm: its springs are those that learners learn for.
        movement: gives the stiffness.
        desired: y.
        equilibrium_rad: û for the configured springs, as the learner predicts it. Shape (n, n_joints).
    """
    if movement.stiffness == 1.0:
        return Command(None, equilibrium_rad)
    configured = Springs.of(arm)
    springs = configured.scaled(movement.stiffness)
    return Command(
        springs,
        springs.equilibrium_for(configured, equilibrium_rad, desired.position_rad, desired.velocity_rad_s),
    )
