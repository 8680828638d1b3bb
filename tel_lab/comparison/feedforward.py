"""Methods that do not learn: the servo alone, and a servo that knows the arm."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from tel_ros.core.learning.inputs import query_inputs
from tel_ros.core.learning.signals import TrialSignals
from tel_ros.core.trajectories.trajectory import DesiredTrajectory
from tel_ros.core.types import FloatArray


class Feedforward:
    """û = y + N(y) with an N that never changes.

    Args:
        predict: N, from inputs (q, q̇, q̈) of shape (n, 3 * n_joints) to offsets u - q [rad] of shape
            (n, n_joints).
        control_period_s: how long one command acts.
    """

    learns, transfers = False, True

    def __init__(self, predict: Callable[[FloatArray], FloatArray], control_period_s: float) -> None:
        self._predict, self._period_s = predict, control_period_s

    def command(self, desired: DesiredTrajectory) -> FloatArray:
        """Return û [rad]. Shape (n, n_joints)."""
        offset: FloatArray = self._predict(query_inputs(desired, self._period_s))
        return desired.position_rad + offset

    def learn(self, trial: TrialSignals, completed: bool) -> None:
        """Do nothing."""


def servo(control_period_s: float) -> Feedforward:
    """Return what every arm can do: the equilibrium point is the desired position."""
    return Feedforward(lambda inputs: np.zeros((len(inputs), inputs.shape[1] // 3)), control_period_s)


def with_velocity_reference(desired: DesiredTrajectory, damping_s: FloatArray) -> FloatArray:
    """Return û [rad] of the servo τ = K (y - q) + B (ẏ - q̇), the usual form: û = y + K⁻¹ B ẏ.

    Whoever chose K and B knows it without any model of the arm.

    Args:
        desired: y.
        damping_s: K⁻¹ B. Shape (n_joints,).
    """
    reference: FloatArray = desired.position_rad + damping_s * desired.velocity_rad_s
    return reference
