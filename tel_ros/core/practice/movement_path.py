"""From a movement to its trajectory and its command, and from a prediction to a forecast."""

from __future__ import annotations

from tel_ros.core.errors import ConfigError
from tel_ros.core.practice.strategy import Forecast, Movement
from tel_ros.core.springs import Springs
from tel_ros.core.trajectories.paths import Path, blended, part, scaled
from tel_ros.core.trajectories.timing import Timing
from tel_ros.core.trajectories.trajectory import DesiredTrajectory, sample
from tel_ros.core.types import FloatArray

_FORECAST_POINTS = 200


def movement_path(goal: Path, known: Path | None, movement: Movement) -> Path:
    """Return the path of a movement: blended, then scaled, then cut. The goal itself if nothing varies.

    ``known`` is the path at shape 0; None: there is none.

    Raises:
        ConfigError: the shape varies, and no path is known.
    """
    path = goal.named(movement.path)
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
    goal: Path, known: Path | None, movement: Movement, rate_hz: float, timing: Timing | None = None
) -> DesiredTrajectory:
    """Return the trajectory of a movement, from rest to rest (see :func:`movement_path`).

    ``timing``: None: minimum jerk in the movement's own duration.
    """
    return sample(movement_path(goal, known, movement), timing or movement.own_duration_s, rate_hz)


def forecast_trajectory(
    goal: Path, known: Path | None, movement: Movement, timing: Timing | None = None
) -> DesiredTrajectory:
    """Return the trajectory to ask the learner about: coarse, with equally many points at any speed."""
    duration_s = timing.duration_s if timing else movement.own_duration_s
    return desired_trajectory(goal, known, movement, _FORECAST_POINTS / duration_s, timing)


def forecast_of(
    desired: DesiredTrajectory,
    equilibrium_rad: FloatArray,
    std_rad: FloatArray,
    configured: Springs,
    movement: Movement,
) -> Forecast:
    """Return a forecast from a prediction: following y exactly takes τ = K (û - y) - B ẏ.

    û and its standard deviation are for the configured springs, K and B; stiffer ones turn the same error in
    the effort into a smaller deviation. Shapes (n, n_joints).
    """
    effort_nm = configured.effort(equilibrium_rad, desired.position_rad, desired.velocity_rad_s)
    return Forecast(std_rad / movement.stiffness, effort_nm, desired.velocity_rad_s, desired.duration_s)


def command(
    configured: Springs, movement: Movement, desired: DesiredTrajectory, equilibrium_rad: FloatArray
) -> tuple[Springs | None, FloatArray]:
    """Return the springs of a movement (None: the configured ones) and û for them."""
    if movement.stiffness == 1.0:
        return None, equilibrium_rad
    springs = configured.scaled(movement.stiffness)
    return springs, springs.equilibrium_for(
        configured, equilibrium_rad, desired.position_rad, desired.velocity_rad_s
    )
