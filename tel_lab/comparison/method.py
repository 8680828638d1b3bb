"""What a method of a comparison does that executes the wanted movement at full speed, trial after trial."""

from __future__ import annotations

from typing import Protocol

from tel_ros.core.learning.signals import TrialSignals
from tel_ros.core.trajectories.trajectory import DesiredTrajectory
from tel_ros.core.types import FloatArray


class Method(Protocol):
    """A way to find the commands of a movement. It changes with each trial that it learns from."""

    learns: bool
    """Whether trials change it; what does not learn does the same again in every trial."""
    transfers: bool
    """Whether it has a command for a movement that it never executed."""

    def command(self, desired: DesiredTrajectory) -> FloatArray:
        """Return the equilibrium trajectory û [rad] to send for a desired one. Shape (n, n_joints).

        Raises:
            TrajectoryError: it has none for this movement.
        """
        ...

    def learn(self, trial: TrialSignals, completed: bool) -> None:
        """Take in a trial.

        Args:
            trial: as recorded.
            completed: False if it was aborted; the record ends with the abort then.

        Raises:
            TrainingError: it cannot be learned from; the method stays as it was.
        """
        ...
