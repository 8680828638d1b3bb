"""Whether the arm may move as fast as practice will ask: known from the path alone, before anything moves."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Self

import numpy as np

from tel_ros.core.config import ArmConfig, Config, PracticeConfig
from tel_ros.core.errors import ConfigError
from tel_ros.core.practice.course import Course
from tel_ros.core.practice.decisions import Movement
from tel_ros.core.practice.movement_path import desired_trajectory
from tel_ros.core.practice.subtasks import parts_of
from tel_ros.core.trajectories.paths import Path

_POINTS = 2000
"""Along a movement, where its velocities are looked at."""
_BETWEEN_POINTS = 1e-4
"""More than the share by which a joint may be faster between two of those points."""
_STEP_S = 0.01
"""Of the durations that are suggested."""


def require_within_velocity_limits(config: Config, path: Path, known: Path | None) -> None:
    """Refuse practice in which a joint would have to move faster than it may, and say how long to take.

    Effort limits show only as practice goes on. How fast the joints move is known from the path: at equal
    shares of the duration, velocities go with its inverse. So a movement beyond a velocity limit is a mistake
    in the configuration, whatever the strategy.

    Args:
        config: practice and arm; the arm's empty limits must have been filled from the URDF.
        path: the configured path.
        known: the path at shape 0; None if there is none.

    Raises:
        ConfigError: the arm would have to move too fast, or the shape varies and no path is known.
    """
    peaks = [_Peak.of(config.arm, path, known, m) for m in _fastest_movements(config.practice)]
    worst = max(peaks, key=lambda peak: peak.share)
    if worst.share * (1.0 + _BETWEEN_POINTS) <= 1.0:
        return
    key, duration_s = _key_of(config.practice, worst.movement), worst.movement.duration_s
    shortest_s = _STEP_S * math.ceil(duration_s * worst.share * (1.0 + _BETWEEN_POINTS) / _STEP_S)
    raise ConfigError(
        f"practice.{key}",
        duration_s,
        f"at least {shortest_s:.2f} s: {worst.joint} would move at {worst.velocity_rad_s:.3f} rad/s"
        f"{_where(worst.movement)}, and arm.velocity_limit_rad_s allows it {worst.limit_rad_s:g} rad/s",
    )


@dataclass(frozen=True)
class _Peak:
    """The highest speed of a movement, in proportion to what the joint may do.

    Args:
        movement: which one.
        joint: its name.
        velocity_rad_s: how fast it moves.
        limit_rad_s: how fast it may.
    """

    movement: Movement
    joint: str
    velocity_rad_s: float
    limit_rad_s: float

    @classmethod
    def of(cls, arm: ArmConfig, path: Path, known: Path | None, movement: Movement) -> Self:
        """Return that of the joint which is nearest to its limit, or furthest beyond."""
        desired = desired_trajectory(path, known, movement, _POINTS / movement.own_duration_s)
        speed, limit = np.abs(desired.velocity_rad_s).max(axis=0), np.array(arm.velocity_limit_rad_s)
        j = int(np.argmax(speed / limit))
        return cls(movement, arm.joints[j], float(speed[j]), float(limit[j]))

    @property
    def share(self) -> float:
        """Speed over limit."""
        return self.velocity_rad_s / self.limit_rad_s


def _fastest_movements(practice: PracticeConfig) -> list[Movement]:
    """Return movements of which one is as fast, joint by joint, as any that practice may try.

    On a leg of the course velocities go with the speed or the amplitude, or lie between those of two paths:
    none is higher than at one of its two ends.
    """
    course = Course.configured(practice)
    if practice.strategy == "direct":
        return [course.goal]
    if practice.strategy == "trajectory_extension" and practice.durations_s:
        return [course.at_duration(min(practice.durations_s))]
    ends = [course.on_leg(leg, value) for leg in course.legs for value in (leg.first, leg.goal)]
    return ends + parts_of(practice) if practice.strategy == "subtasks" else ends


def _key_of(practice: PracticeConfig, movement: Movement) -> str:
    """Return the key that gives a movement its duration."""
    if practice.strategy == "trajectory_extension" and practice.durations_s:
        return "durations_s"
    return "goal_duration_s" if movement.duration_s == practice.goal_duration_s else "first_duration_s"


def _where(movement: Movement) -> str:
    if movement.shape == 0.0:
        return " on the known path"
    if (movement.start, movement.end) != (0.0, 1.0):
        return f" from {movement.start:.3g} to {movement.end:.3g} of the path"
    return ""
