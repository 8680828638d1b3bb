"""How fast the arm's limits let movements be: velocity from the path alone, effort as practice goes on."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

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
    goes on.) The arm's empty limits must have been filled from the URDF.

    Raises:
        ConfigError: the arm would have to move too fast, or the shape varies and no path is known.
    """
    arm, limit = config.arm, np.array(config.arm.velocity_limit_rad_s)
    worst_share, fastest, speed, j = 0.0, movements[0], limit, 0
    for movement in movements:
        desired = desired_trajectory(path, known, movement, _POINTS / movement.own_duration_s)
        peaks = np.abs(desired.velocity_rad_s).max(axis=0)
        share = float((peaks / limit).max())
        if share > worst_share:
            worst_share, fastest, speed, j = share, movement, peaks, int(np.argmax(peaks / limit))
    if worst_share * (1.0 + _BETWEEN_POINTS) <= 1.0:
        return
    key, value = _setting_of(config.practice, fastest.duration_s)
    shortest_s = _STEP_S * math.ceil(fastest.duration_s * worst_share * (1.0 + _BETWEEN_POINTS) / _STEP_S)
    where = "" if fastest.is_whole else f" {fastest.part_text}"
    if fastest.shape == 0.0:
        where = " on the known path"
    if fastest.path:
        where += f" ({fastest.path})"
    raise ConfigError(
        f"practice.{key}",
        value,
        f"at least {shortest_s:.2f} s: {arm.joints[j]} would move at {speed[j]:.3f} rad/s{where}, and "
        f"arm.velocity_limit_rad_s allows it {limit[j]:g} rad/s",
    )


def _setting_of(practice: PracticeConfig, duration_s: float) -> tuple[str, object]:
    """Return the key that gives a movement its duration, and its value."""
    if duration_s in practice.durations_s:
        return "durations_s", duration_s
    for key in ("goal_duration_s", "first_duration_s"):
        if duration_s == getattr(practice, key):
            return key, duration_s
    return "strategy", f"{practice.strategy} with movements of {duration_s:g} s"


_USABLE_SHARE = 0.97
"""The rest of the effort is left to the springs, which correct what the network gets wrong."""
_MOST_DURATIONS = 6
_BISECTIONS = 40


class EffortLimit:
    """The effort that a movement needs at speeds that have not been tried.

    At equal shares of the duration T a rigid arm needs τ = a + c / T²: a from gravity and dry friction, c
    from inertia, centrifugal and Coriolis forces (Hollerbach 1984). Viscous friction goes with 1 / T, between
    the two terms. The learner says what was needed at the speeds that it has learned; what was commanded then
    held errors, too. No model of the arm is used. ``at_duration`` gives the movement of a duration in s, with
    whatever else it has while its speed varies.
    """

    def __init__(self, arm: ArmConfig, at_duration: Callable[[float], Movement] = Movement) -> None:
        self._joints = arm.joints
        self._limit_nm = np.array(arm.effort_limit_nm)
        self._at_duration = at_duration
        self._durations_s: list[float] = []
        self._static_nm = self._dynamic_nms2 = np.zeros((1, len(arm.joints)))

    def heed(self, given_nm: Mapping[str, float]) -> None:
        """Take in how much of their commands drives have given that are limited to less; by joint."""
        for j, joint in enumerate(self._joints):
            self._limit_nm[j] = min(self._limit_nm[j], given_nm.get(joint, math.inf))

    def learn(self, duration_s: float, forecast: Forecaster) -> None:
        """Take in that the learner knows the movement at this duration now."""
        if duration_s not in self._durations_s:
            self._durations_s.append(duration_s)
        # What it says about earlier ones may have changed as well: it is asked again. The slowest tells the
        # static part from the others; of those the fastest are nearest to what is asked for.
        durations_s = np.array(sorted(self._durations_s)[: _MOST_DURATIONS - 1] + [max(self._durations_s)])
        durations_s = np.unique(durations_s)
        efforts_nm = np.stack([forecast(self._at_duration(float(t))).effort_nm for t in durations_s])
        columns = [durations_s**-2.0, np.ones_like(durations_s)][: len(durations_s)]
        flat_nm = efforts_nm.reshape(len(durations_s), -1)
        solution = np.linalg.lstsq(np.column_stack(columns), flat_nm, rcond=None)[0]
        self._dynamic_nms2, *static = solution.reshape(len(columns), *efforts_nm.shape[1:])
        self._static_nm = static[0] if static else np.zeros_like(self._dynamic_nms2)

    def needed_nm(self, duration_s: float) -> FloatArray:
        """Return the largest effort that each joint needs. Shape (n_joints,); zeros if nothing is known."""
        return np.abs(self._static_nm + self._dynamic_nms2 / duration_s**2).max(axis=0)

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
