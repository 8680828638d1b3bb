"""Methods that keep one command sequence and correct it from trial to trial."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

from tel_ros.core.errors import TrajectoryError
from tel_ros.core.learning.signals import TrialSignals
from tel_ros.core.trajectories.trajectory import DesiredTrajectory
from tel_ros.core.types import FloatArray


class StoredCommand(ABC):
    """A command sequence for one movement; there is no model in it that another movement could ask.

    After a trial that was aborted it goes back to the last command
    that was completed and makes half as large corrections from then on (ours: with the same correction the
    same trial would follow, and be aborted, for ever).

    Args:
        desired: the movement.
        initial_rad: the command to begin with. Shape (n, n_joints).
    """

    learns, transfers = True, False

    def __init__(self, desired: DesiredTrajectory, initial_rad: FloatArray) -> None:
        self._desired = desired
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
        self._completed = self._command
        self._command = self._corrected(self._command, tracking_error(trial), self._caution)

    @abstractmethod
    def _corrected(self, command_rad: FloatArray, error_rad: FloatArray, caution: float) -> FloatArray:
        """Return the next command.

        Args:
            command_rad: û of the trial. Shape (n, n_joints).
            error_rad: y - ŷ from the first tick of RUN to the end of the record. Shape (m, n_joints), m >= n.
            caution: factor on the correction.
        """


def tracking_error(trial: TrialSignals) -> FloatArray:
    """Return y - ŷ in rad from the first tick of RUN to the end of the record. Shape (m, n_joints)."""
    first = int(np.argmax(trial.run))
    position_rad = trial.position_rad[first:]
    error_rad: FloatArray = trial.desired[first:, : position_rad.shape[1]] - position_rad
    return error_rad
