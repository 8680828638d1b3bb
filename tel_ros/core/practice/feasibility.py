"""How fast the arm's limits let movements be: velocity from the path alone, effort as practice goes on."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from tel_ros.core.config import ArmConfig, Config, PracticeConfig
from tel_ros.core.errors import ConfigError
from tel_ros.core.practice.movement_path import desired_trajectory
from tel_ros.core.practice.strategy import Forecaster, Movement
from tel_ros.core.trajectories.paths import Path
from tel_ros.core.types import FloatArray

_POINTS = 2000
"""Along a movement, where its velocities are looked at."""
_BETWEEN_POINTS = 1e-4
"""More than the share by which a joint may be faster between two of those points."""
_STEP_S = 0.01
"""Of the durations that are suggested."""


def require_within_velocity_limits(
    config: Config, movements: Sequence[Movement], path: Path, known: Path | None
) -> None:
    """Refuse practice in which a joint would have to move faster than it may, and say how long to take.

    Velocities are known from the path alone: at equal shares of the duration they go with its inverse. So a
    movement beyond a velocity limit is a mistake in the configuration. (Effort limits show only as practice
    goes on.)

    Args:
        config: practice and arm; the arm's empty limits must have been filled from the URDF.
        movements: the fastest of the strategy.
        path: the configured path.
        known: the path at shape 0; None if there is none.

    Raises:
        ConfigError: the arm would have to move too fast, or the shape varies and no path is known.
    """
    worst = max((_Peak.of(config.arm, path, known, m) for m in movements), key=lambda peak: peak.share)
    if worst.share * (1.0 + _BETWEEN_POINTS) <= 1.0:
        return
    (key, value), duration_s = _setting_of(config.practice, worst.movement), worst.movement.duration_s
    shortest_s = _STEP_S * math.ceil(duration_s * worst.share * (1.0 + _BETWEEN_POINTS) / _STEP_S)
    raise ConfigError(
        f"practice.{key}",
        value,
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


def _setting_of(practice: PracticeConfig, movement: Movement) -> tuple[str, object]:
    """Return the key that gives a movement its duration, and its value."""
    duration_s = movement.duration_s
    if duration_s in practice.durations_s:
        return "durations_s", duration_s
    for key in ("goal_duration_s", "first_duration_s"):
        if duration_s == getattr(practice, key):
            return key, duration_s
    return "strategy", f"{practice.strategy} with movements of {duration_s:g} s"


def _where(movement: Movement) -> str:
    if movement.shape == 0.0:
        return " on the known path"
    if not movement.is_whole:
        return f" from {movement.start:.3g} to {movement.end:.3g} of the path"
    return ""


_USABLE_SHARE = 0.97
"""The rest of the effort is left to the springs, which correct what the network gets wrong."""
_MOST_DURATIONS = 6
_BISECTIONS = 40


class EffortLimit:
    """The effort that a movement needs at speeds that have not been tried.

    At equal shares of the duration T a rigid arm needs τ = a + c / T²: a from gravity and dry friction, c
    from inertia, centrifugal and Coriolis forces (Hollerbach 1984). Viscous friction goes with 1 / T, between
    the two terms. The learner says what was needed at the speeds that it has learned; what was commanded then
    held errors, too. No model of the arm is used.

    Args:
        arm: joints and effort limits.
        at_duration: the movement of a duration in s, with whatever else it has while its speed varies.
    """

    def __init__(self, arm: ArmConfig, at_duration: Callable[[float], Movement] = Movement) -> None:
        self._joints = arm.joints
        self._limit_nm = np.array(arm.effort_limit_nm)
        self._at_duration = at_duration
        self._durations_s: list[float] = []
        self._static_nm: FloatArray | None = None
        self._dynamic_nms2: FloatArray | None = None

    def learn(self, duration_s: float, forecast: Forecaster) -> None:
        """Take in that the learner knows the movement at this duration now."""
        if duration_s not in self._durations_s:
            self._durations_s.append(duration_s)
        # What it says about earlier ones may have changed as well: it is asked again. The slowest tells the
        # static part from the others; of those the fastest are nearest to what is asked for.
        durations_s = np.array(sorted(self._durations_s)[: _MOST_DURATIONS - 1] + [max(self._durations_s)])
        durations_s = np.unique(durations_s)
        efforts_nm = np.stack([forecast(self._at_duration(float(t))).effort_nm for t in durations_s])
        columns = [durations_s**-2.0]
        if len(durations_s) > 1:
            columns.append(np.ones_like(durations_s))
        solution = np.linalg.lstsq(
            np.column_stack(columns), efforts_nm.reshape(len(durations_s), -1), rcond=None
        )[0].reshape(len(columns), *efforts_nm.shape[1:])
        self._dynamic_nms2 = solution[0]
        self._static_nm = solution[1] if len(durations_s) > 1 else np.zeros_like(solution[0])

    def needed_nm(self, duration_s: float) -> FloatArray:
        """Return the largest effort that each joint needs. Shape (n_joints,); zeros if nothing is known."""
        if self._dynamic_nms2 is None or self._static_nm is None:
            return np.zeros(len(self._joints))
        needed: FloatArray = np.abs(self._static_nm + self._dynamic_nms2 / duration_s**2).max(axis=0)
        return needed

    def fastest_s(self, goal_s: float, known_s: float) -> float:
        """Return the shortest duration from ``goal_s`` to ``known_s`` that the limits allow."""
        if self._allows(goal_s) or known_s <= goal_s:
            return goal_s
        low, high = goal_s, known_s
        for _ in range(_BISECTIONS):
            middle = 0.5 * (low + high)
            low, high = (low, middle) if self._allows(middle) else (middle, high)
        return high

    def needed_text(self, duration_s: float) -> str:
        """Say what the joint that is nearest to its limit would need."""
        needed = self.needed_nm(duration_s)
        j = int(np.argmax(needed / self._limit_nm))
        return f"{self._joints[j]} would need {needed[j]:.1f} N·m (limit {self._limit_nm[j]:g} N·m)"

    def _allows(self, duration_s: float) -> bool:
        return bool(np.all(self.needed_nm(duration_s) <= _USABLE_SHARE * self._limit_nm))
