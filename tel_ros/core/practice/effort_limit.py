"""How fast the effort limits let a movement be, foreseen from slower ones."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from tel_ros.core.config import ArmConfig
from tel_ros.core.practice.decisions import Forecaster, Movement
from tel_ros.core.types import FloatArray

_USABLE_SHARE = 0.97
"""The rest of the effort is left to the springs, which correct what the network gets wrong."""
_MOST_DURATIONS = 6
_BISECTIONS = 40


class EffortLimit:
    """The effort that a movement needs at speeds that have not been tried.

    At equal shares of the duration T a rigid arm needs τ = a + c / T²: a from gravity and dry friction, c
    from inertia, centrifugal and Coriolis forces (Hollerbach 1984). Viscous friction goes with 1 / T;
    between the two terms it is hardly missed. The learner says what was needed at the speeds that it has
    learned, which is more than what was commanded then: that held errors, too. No model of the arm is used.

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
