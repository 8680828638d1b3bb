"""Iterative learning control as in the textbooks: P- and D-type, with a lead and a zero-phase filter."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tel_lab.comparison.stored_command import StoredCommand
from tel_lab.comparison.zero_phase import zero_phase
from tel_ros.core.trajectories.trajectory import DesiredTrajectory
from tel_ros.core.types import FloatArray


@dataclass(frozen=True)
class IlcGains:
    """Gains of the learning law.

    The defaults come from a random search over a simulation of the arm of ``config/paper.yaml`` and of two
    with 0.8 and 1.25 times its inertia: the least error at 4.5 s after 15 trials.

    Args:
        proportional: k_p, in rad of command a rad of error.
        derivative_s: k_d.
        lead_s: Δ, how much later than a command its effect is looked for.
        cutoff_hz: of the filter Q.
    """

    proportional: float = 0.35
    derivative_s: float = 0.1
    lead_s: float = 0.05
    cutoff_hz: float = 10.0


class IterativeLearningControl(StoredCommand):
    """û ← Q [û + k_p e(t + Δ) + k_d ė(t + Δ)], e = y - ŷ.

    Arimoto, Kawamura and Miyazaki (1984) with the zero-phase Q of later textbooks; see Bristow, Tharayil and
    Alleyne, "A Survey of Iterative Learning Control" (2006).

    Args:
        desired: the movement.
        initial_rad: the command to begin with. Shape (n, n_joints).
        period_s: from command to command.
        gains: of the learning law.
    """

    def __init__(
        self,
        desired: DesiredTrajectory,
        initial_rad: FloatArray,
        period_s: float,
        gains: IlcGains | None = None,
    ) -> None:
        super().__init__(desired, initial_rad)
        self._gains, self._period_s = gains or IlcGains(), period_s

    def _corrected(self, command_rad: FloatArray, error_rad: FloatArray, caution: float) -> FloatArray:
        gains = self._gains
        rate = np.gradient(error_rad, self._period_s, axis=0)
        law = gains.proportional * error_rad + gains.derivative_s * rate
        # After the end of the record the arm is at rest; the last error stands for what would follow.
        lead = round(gains.lead_s / self._period_s)
        later = np.minimum(np.arange(len(command_rad)) + lead, len(law) - 1)
        return zero_phase(command_rad + caution * law[later], gains.cutoff_hz, self._period_s)
