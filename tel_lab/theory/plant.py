"""The plant as the theorems see it, fitted to what was recorded, and Lipschitz constants from slopes."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Self

import numpy as np

from tel_ros.core.learning.inputs import InputRange
from tel_ros.core.learning.signals import TrainingSamples
from tel_ros.core.types import FloatArray

Function = Callable[[FloatArray], FloatArray]
"""From rows of inputs, shape (n, n_inputs), to rows of outputs, shape (n, n_outputs)."""

_STEP = 1e-3
"""Of the differences that stand for derivatives, as a share of each input's range: far below the width of
the narrowest Gaussian that is of use, and far above rounding."""

_SINGULAR = 1e-9
"""Ratio of singular values from which a slope counts as one that cannot be inverted."""


def size(values: FloatArray, n_joints: int) -> float:
    """Return ‖values‖, the norm of a trajectory: the root mean square over samples and joints.

    For commands and angles that is the RMS that trials are scored with. For inputs of the network, which
    have three values a joint, the squares of all three are added up; so the norm of inputs and that of
    commands differ from Euclid's by the same factor, and spectral norms are Lipschitz constants between them.
    """
    return float(np.sqrt(np.sum(values**2) / (len(values) * n_joints)))


def slopes(function: Function, inputs: FloatArray, unit: FloatArray) -> FloatArray:
    """Return the derivatives of a function along a trajectory, by central differences.

    That is the change of the outputs for a unit of each input. Shape (n, n_outputs, n_inputs).
    """
    n, n_inputs = inputs.shape
    step = np.diag(_STEP * unit)
    ahead = function((inputs[:, None, :] + step).reshape(-1, n_inputs))
    behind = function((inputs[:, None, :] - step).reshape(-1, n_inputs))
    return ((ahead - behind) / (2.0 * _STEP)).reshape(n, n_inputs, -1).transpose(0, 2, 1)


def steepest(matrices: FloatArray) -> float:
    """Return the Lipschitz constant that slopes along a trajectory show: 95 % of their norms lie below it.

    The largest one would hang on a single sample; and it would be no bound either, because nothing is known
    between the samples. Norms are spectral norms; NaN if a slope is not finite.
    """
    if not np.all(np.isfinite(matrices)):
        return math.nan
    return float(np.percentile(np.linalg.norm(matrices, 2, axis=(1, 2)), 95.0))


def inverses(matrices: FloatArray) -> FloatArray:
    """Return the inverse of each matrix, shape (n, m, m); NaN for all if one of them has none."""
    singular_values = np.linalg.svd(matrices, compute_uv=False)
    if np.any(singular_values[:, -1] <= _SINGULAR * singular_values[:, 0]):
        return np.full_like(matrices, np.nan)
    return np.asarray(np.linalg.inv(matrices), dtype=np.float64)


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

    ``normal`` sums products of inputs, shape (3 * n_joints + 1, 3 * n_joints + 1); ``moment`` those of inputs
    and outputs.
    """

    input_range: InputRange
    normal: FloatArray = field(repr=False)
    moment: FloatArray = field(repr=False)

    @classmethod
    def unknown(cls, input_range: InputRange) -> Self:
        n_inputs = len(input_range.low)
        shape = n_inputs + 1, n_inputs + 1
        return cls(input_range, np.zeros(shape), np.zeros((n_inputs + 1, n_inputs // 3)))

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
        return self._inputs(inputs) @ weights

    def _inputs(self, inputs: FloatArray) -> FloatArray:
        low, high = self.input_range.low, self.input_range.high
        centred = (inputs - 0.5 * (low + high)) / (high - low)
        return np.column_stack([centred, np.ones(len(inputs))])


def plant_slopes(inverse: Function, inputs: FloatArray, unit: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return how the plant y = P(x) u answers along a trajectory, to first order; x = (q, q̇), y = (q, q̇, q̈).

    Derived from its inverse: u = q + offset(q, q̇, q̈) is differentiated and solved for q̈. NaN where some
    acceleration does not depend on the command. Their Lipschitz constants are k_x and k_u ([Practice] A1).

    Args:
        inverse: from (q, q̇, q̈) to u [rad].
        inputs: (q, q̇, q̈). Shape (n, 3 * n_joints).
        unit: of q, q̇, q̈. Shape (3 * n_joints,).

    Returns:
        ∂y/∂x, shape (n, 3 * n_joints, 2 * n_joints), and ∂y/∂u per rad, shape (n, 3 * n_joints, n_joints).
    """
    slope = slopes(inverse, inputs, unit)
    n, n_joints, n_inputs = slope.shape
    n_states = n_inputs - n_joints
    gain = inverses(slope[:, :, n_states:])
    state = np.broadcast_to(np.eye(n_states), (n, n_states, n_states))
    by_state = np.concatenate([state, -gain @ slope[:, :, :n_states]], axis=1)
    return by_state, np.concatenate([np.zeros((n, n_states, n_joints)), gain], axis=1)
