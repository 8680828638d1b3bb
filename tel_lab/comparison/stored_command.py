"""Methods that keep one command sequence and correct it from trial to trial, without any model."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np
from scipy.signal import butter, sosfiltfilt

from tel_ros.core.errors import TrajectoryError
from tel_ros.core.learning.signals import TrialSignals
from tel_ros.core.trajectories.trajectory import DesiredTrajectory
from tel_ros.core.types import FloatArray


def zero_phase(command_rad: FloatArray, cutoff_hz: float, period_s: float) -> FloatArray:
    """Return a command without its fast parts: Butterworth of order 2, forwards and backwards.

    Beyond both ends the command goes on at its first and last value, as the controller holds it. The cutoff
    is -3 dB of one pass, below half of the sampling rate.
    """
    width = round(3.0 / cutoff_hz / period_s)  # three periods of the cutoff
    held = np.pad(command_rad, ((width, width), (0, 0)), mode="edge")
    filtered: FloatArray = sosfiltfilt(butter(2, cutoff_hz, fs=1.0 / period_s, output="sos"), held, axis=0)
    return filtered[width : len(filtered) - width]


class StoredCommand(ABC):
    """A command sequence for one movement; there is no model in it that another movement could ask.

    After a trial that was aborted it goes back to the last command that was completed and makes half as large
    corrections from then on (ours: with the same correction the same trial would be aborted for ever).
    """

    learns, transfers = True, False
    cutoff_hz: float
    """Of the zero-phase filter Q."""

    def __init__(self, desired: DesiredTrajectory, initial_rad: FloatArray, period_s: float) -> None:
        self._desired, self._period_s = desired, period_s
        self._command = self._completed = initial_rad
        self._caution = 1.0

    def command(self, desired: DesiredTrajectory) -> FloatArray:
        """Return û [rad]. Shape (n, n_joints).

        Raises:
            TrajectoryError: it is not the movement that is stored.
        """
        same = np.array_equal(desired.time_ns, self._desired.time_ns)
        if not (same and np.array_equal(desired.position_rad, self._desired.position_rad)):
            raise TrajectoryError(
                f"the stored command is for another movement than this one of {desired.duration_s} s; "
                "expected the movement that was practised"
            )
        return self._command

    def learn(self, trial: TrialSignals, completed: bool) -> None:
        """Correct the command after a completed trial, or go back after another one."""
        if not completed:
            self._command = self._completed
            self._caution *= 0.5
            return
        first = int(np.argmax(trial.run))
        position_rad = trial.position_rad[first:]
        error_rad: FloatArray = trial.desired[first:, : position_rad.shape[1]] - position_rad
        corrected = self._command + self._caution * self._correction(error_rad, len(self._command))
        self._completed = self._command
        self._command = zero_phase(corrected, self.cutoff_hz, self._period_s)

    @abstractmethod
    def _correction(self, error_rad: FloatArray, n: int) -> FloatArray:
        """Return what to add to û before the filter. Shape (n, n_joints).

        ``error_rad``: y - ŷ from the first tick of RUN to the end of the record. Shape (m, n_joints), m >= n.
        """


class IterativeLearningControl(StoredCommand):
    """û ← Q [û + k_p e(t + Δ) + k_d ė(t + Δ)], e = y - ŷ.

    Arimoto, Kawamura and Miyazaki (1984) with the zero-phase Q of later textbooks; see Bristow, Tharayil and
    Alleyne, "A Survey of Iterative Learning Control" (2006). The gains come from a random search over a
    simulation of the arm of ``config/paper.yaml`` and of two with 0.8 and 1.25 times its inertia: the least
    error at 4.5 s after 15 trials.
    """

    cutoff_hz = 10.0
    _proportional, _derivative_s, _lead_s = 0.35, 0.1, 0.05
    """k_p, k_d, and Δ: how much later than a command its effect is looked for."""

    def _correction(self, error_rad: FloatArray, n: int) -> FloatArray:
        rate = np.gradient(error_rad, self._period_s, axis=0)
        law: FloatArray = self._proportional * error_rad + self._derivative_s * rate
        # After the end of the record the arm is at rest; the last error stands for what would follow.
        later = np.minimum(np.arange(n) + round(self._lead_s / self._period_s), len(law) - 1)
        return law[later]


class VirtualTrajectoryLearning(StoredCommand):
    """û ← Q [û + g (y - ŷ)]: the virtual trajectory moves by a share of what the arm missed.

    So a virtual trajectory for a wanted movement is found without inverse dynamics; Katayama and Kawato
    (1993) compute it with a learned model. Above the resonance of arm and spring the correction has the wrong
    sign and every gain diverges, so Q has to cut there: that bounds what is reached. g and Q were found like
    the gains of iterative learning control.
    """

    cutoff_hz = 2.0
    _gain = 0.15

    def _correction(self, error_rad: FloatArray, n: int) -> FloatArray:
        return self._gain * error_rad[:n]
