"""From what a learner predicts to what a strategy may know."""

from __future__ import annotations

import numpy as np

from tel_ros.core.config import ArmConfig
from tel_ros.core.practice.decisions import Forecast, Movement
from tel_ros.core.practice.movement_path import desired_trajectory
from tel_ros.core.trajectories.paths import Path
from tel_ros.core.trajectories.trajectory import DesiredTrajectory
from tel_ros.core.types import FloatArray

_POINTS = 200


def forecast_trajectory(path: Path, known: Path | None, movement: Movement) -> DesiredTrajectory:
    """Return the trajectory to ask the learner about: coarse, and with equally many points at any speed.

    Args:
        path: the configured one.
        known: the path at shape 0; None if there is none.
        movement: what to do on the way between them.

    Raises:
        ConfigError: the shape is to be varied, and no path is known.
    """
    return desired_trajectory(path, known, movement, _POINTS / movement.own_duration_s)


def forecast_of(
    desired: DesiredTrajectory,
    offset_rad: FloatArray,
    std_rad: FloatArray,
    arm: ArmConfig,
    movement: Movement,
) -> Forecast:
    """Return a forecast from a prediction.

    Args:
        desired: what was asked about.
        offset_rad: û - q_d. Shape (n, n_joints).
        std_rad: its standard deviation. Shape (n, n_joints).
        arm: K and B that the prediction is for: following y exactly takes τ = K (û - q_d) - B q̇_d.
        movement: stiffer springs make less of a deviation of the same error in the effort.
    """
    stiffness, damping = np.array(arm.stiffness_nm_per_rad), np.array(arm.damping_nms_per_rad)
    return Forecast(std_rad / movement.stiffness, stiffness * offset_rad - damping * desired.velocity_rad_s)
