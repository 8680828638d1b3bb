"""From a movement that a strategy asks for to the trajectory and the command that go to the controller."""

from __future__ import annotations

from dataclasses import dataclass

from tel_ros.core.config import ArmConfig
from tel_ros.core.errors import ConfigError
from tel_ros.core.practice.decisions import Movement
from tel_ros.core.springs import Springs
from tel_ros.core.trajectories.paths import Path, blended, part, scaled
from tel_ros.core.trajectories.trajectory import DesiredTrajectory, sample
from tel_ros.core.types import FloatArray


def movement_path(goal: Path, known: Path | None, movement: Movement) -> Path:
    """Return the path of a movement: blended, then drawn together, then the part that is asked for.

    A movement that varies none of these gets the goal path itself.

    Args:
        goal: the configured path.
        known: the path at shape 0; None if there is none.
        movement: what to vary, and how far.

    Raises:
        ConfigError: the shape is to be varied, and no path is known.
    """
    path = goal
    if movement.shape != 1.0:
        if known is None:
            raise ConfigError("path.known_name", "", "a known path (or known_file), because shape is varied")
        path = blended(known, path, movement.shape)
    if movement.amplitude != 1.0:
        path = scaled(path, movement.amplitude)
    if (movement.start, movement.end) != (0.0, 1.0):
        path = part(path, movement.start, movement.end)
    return path


def desired_trajectory(
    goal: Path, known: Path | None, movement: Movement, rate_hz: float
) -> DesiredTrajectory:
    """Return the trajectory of a movement, from rest to rest; a part of the path has its own start and stop.

    Args:
        goal: the configured path.
        known: the path at shape 0; None if there is none.
        movement: what to vary, and how far.
        rate_hz: points a second.

    Raises:
        ConfigError: the shape is to be varied, and no path is known.
    """
    return sample(movement_path(goal, known, movement), movement.own_duration_s, rate_hz)


@dataclass(frozen=True)
class Command:
    """What the springs of one trial have to do.

    Args:
        springs: K and B; None: as configured.
        equilibrium_rad: û. Shape (n, n_joints).
    """

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
