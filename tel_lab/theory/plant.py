"""The plant as the theorems see it: fitted to what was recorded, and the constants that follow from it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Self

import numpy as np

from tel_lab.theory.lipschitz import Function, inverses, slopes, steepest
from tel_ros.core.learning.inputs import InputRange
from tel_ros.core.learning.signals import TrainingSamples
from tel_ros.core.types import FloatArray

_FORGETTING = 0.5
"""Weight of a trial in the next one's fit: the plant is to be right near the movement of the moment."""

_RIDGE = 1e-6
"""Of the mean square of the inputs. In one harmonic movement position and acceleration are proportional, and
nothing tells which of them had the effect; this little decides for both. Two speeds tell them apart."""


@dataclass(frozen=True)
class FittedPlant:
    """A straight-line model of the inverse dynamics: u - q = c + A (q, q̇, q̈), by least squares.

    It is much too coarse to command an arm. It is meant for *differences*: what was sent, û, is known to
    produce ŷ, so the command that y needs is u ≈ û + (y - ŷ as a change of command). And it does not share
    the network's mistakes, which is the point: the network cannot tell how wrong it is itself.

    Args:
        input_range: units of the inputs.
        normal: sums of products of inputs. Shape (3 * n_joints + 1, 3 * n_joints + 1).
        moment: sums of products of inputs and outputs. Shape (3 * n_joints + 1, n_joints).
    """

    input_range: InputRange
    normal: FloatArray = field(repr=False)
    moment: FloatArray = field(repr=False)

    @classmethod
    def unknown(cls, input_range: InputRange) -> Self:
        """Return the model before the first trial."""
        n_inputs = len(input_range.low)
        return cls(
            input_range, np.zeros((n_inputs + 1, n_inputs + 1)), np.zeros((n_inputs + 1, n_inputs // 3))
        )

    def after(self, samples: TrainingSamples) -> Self:
        """Return the model that has seen one more trial; each counts twice as much as the one before it."""
        inputs = self._inputs(samples.actual)
        n = len(inputs)
        return type(self)(
            self.input_range,
            _FORGETTING * self.normal + inputs.T @ inputs / n,
            _FORGETTING * self.moment + inputs.T @ samples.offset_rad / n,
        )

    def predict(self, inputs: FloatArray) -> FloatArray:
        """Return u - q [rad] for (q, q̇, q̈) of shape (n, 3 * n_joints). Shape (n, n_joints)."""
        ridge = _RIDGE * np.trace(self.normal) / len(self.normal) * np.eye(len(self.normal))
        weights = np.linalg.solve(self.normal + ridge, self.moment)
        offset: FloatArray = self._inputs(inputs) @ weights
        return offset

    def _inputs(self, inputs: FloatArray) -> FloatArray:
        low, high = self.input_range.low, self.input_range.high
        centred = (inputs - 0.5 * (low + high)) / (high - low)
        return np.column_stack([centred, np.ones(len(inputs))])


@dataclass(frozen=True)
class PlantSlopes:
    """How the plant answers, to first order: y = P(x) u, state x = (q, q̇), command u, motion y = (q, q̇, q̈).

    Derived from its inverse: u = q + offset(q, q̇, q̈) is differentiated along a trajectory and solved
    for q̈.

    Args:
        by_state: ∂y/∂x. Shape (n, 3 * n_joints, 2 * n_joints).
        by_command: ∂y/∂u, per rad. Shape (n, 3 * n_joints, n_joints).
    """

    by_state: FloatArray
    by_command: FloatArray

    @classmethod
    def along(cls, inverse: Function, inputs: FloatArray, unit: FloatArray) -> Self:
        """Return the slopes along a trajectory; NaN where some acceleration does not depend on the command.

        Args:
            inverse: from (q, q̇, q̈) to u [rad].
            inputs: (q, q̇, q̈). Shape (n, 3 * n_joints).
            unit: of q, q̇, q̈. Shape (3 * n_joints,).
        """
        slope = slopes(inverse, inputs, unit)
        n, n_joints, n_inputs = slope.shape
        n_states = n_inputs - n_joints
        gain = inverses(slope[:, :, n_states:])
        state = np.broadcast_to(np.eye(n_states), (n, n_states, n_states))
        return cls(
            by_state=np.concatenate([state, -gain @ slope[:, :, :n_states]], axis=1),
            by_command=np.concatenate([np.zeros((n, n_states, n_joints)), gain], axis=1),
        )

    @property
    def k_x(self) -> float:
        """Lipschitz constant of the motion with respect to the state ([Practice] A1)."""
        return steepest(self.by_state)

    @property
    def k_u(self) -> float:
        """Lipschitz constant of the motion with respect to the command ([Practice] A1)."""
        return steepest(self.by_command)
