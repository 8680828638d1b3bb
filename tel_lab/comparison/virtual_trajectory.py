"""Repetitive correction of the virtual (equilibrium) trajectory, without any model."""

from __future__ import annotations

from tel_lab.comparison.stored_command import StoredCommand
from tel_lab.comparison.zero_phase import zero_phase
from tel_ros.core.trajectories.trajectory import DesiredTrajectory
from tel_ros.core.types import FloatArray


class VirtualTrajectoryLearning(StoredCommand):
    """û ← Q [û + g (y - ŷ)]: the virtual trajectory moves by a share of what the arm missed.

    So a virtual trajectory for a wanted movement is found without inverse dynamics; Katayama and Kawato
    (1993) compute it with a learned model. Above the resonance of arm and spring the correction has the wrong
    sign and every gain diverges, so Q has to cut there: that bounds what is reached.

    Args:
        desired: the movement.
        initial_rad: the command to begin with. Shape (n, n_joints).
        period_s: from command to command.
        gain: g; the defaults were found like those of iterative learning control.
        cutoff_hz: of the zero-phase filter Q.
    """

    def __init__(
        self,
        desired: DesiredTrajectory,
        initial_rad: FloatArray,
        period_s: float,
        *,
        gain: float = 0.15,
        cutoff_hz: float = 2.0,
    ) -> None:
        super().__init__(desired, initial_rad)
        self._period_s, self._gain, self._cutoff_hz = period_s, gain, cutoff_hz

    def _corrected(self, command_rad: FloatArray, error_rad: FloatArray, caution: float) -> FloatArray:
        corrected = command_rad + caution * self._gain * error_rad[: len(command_rad)]
        return zero_phase(corrected, self._cutoff_hz, self._period_s)
