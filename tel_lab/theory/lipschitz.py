"""Sizes of trajectories and slopes of functions between them: what Lipschitz constants are estimated from."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from tel_ros.core.types import FloatArray

Function = Callable[[FloatArray], FloatArray]
"""From rows of inputs, shape (n, n_inputs), to rows of outputs, shape (n, n_outputs)."""

_STEP = 1e-3
"""Of the differences that stand for derivatives, as a share of each input's range: far below the width of
the narrowest Gaussian that is of use, and far above rounding."""

_NEARLY_ALL = 95.0
"""Percentile that stands for the largest of many slopes."""

_SINGULAR = 1e-9
"""Ratio of singular values from which a slope counts as one that cannot be inverted."""


def size(values: FloatArray, n_joints: int) -> float:
    """Return ‖values‖, the norm of a trajectory: the root mean square over samples and joints.

    For commands and angles that is the RMS that trials are scored with. For inputs of the network, which
    have three values a joint, the squares of all three are added up; so the norm of inputs and that of
    commands differ from Euclid's by the same factor, and spectral norms are Lipschitz constants between them.

    Args:
        values: shape (n, n_joints) or (n, 3 * n_joints).
        n_joints: number of joints.
    """
    return float(np.sqrt(np.sum(values**2) / (len(values) * n_joints)))


def slopes(function: Function, inputs: FloatArray, unit: FloatArray) -> FloatArray:
    """Return the derivatives of a function along a trajectory, by central differences.

    Args:
        function: what to differentiate.
        inputs: where. Shape (n, n_inputs).
        unit: what counts as 1 in each input. Shape (n_inputs,).

    Returns:
        Change of the outputs for a unit of each input. Shape (n, n_outputs, n_inputs).
    """
    n, n_inputs = inputs.shape
    step = np.diag(_STEP * unit)
    ahead = function((inputs[:, None, :] + step).reshape(-1, n_inputs))
    behind = function((inputs[:, None, :] - step).reshape(-1, n_inputs))
    return ((ahead - behind) / (2.0 * _STEP)).reshape(n, n_inputs, -1).transpose(0, 2, 1)


def steepest(matrices: FloatArray) -> float:
    """Return the Lipschitz constant that slopes along a trajectory show: 95 % of their norms lie below it.

    The largest one would hang on a single sample; and it would be no bound either, because nothing is known
    between the samples. Norms are spectral norms.

    Args:
        matrices: shape (n, n_outputs, n_inputs).

    Returns:
        NaN if a slope is not finite.
    """
    if not np.all(np.isfinite(matrices)):
        return math.nan
    return float(np.percentile(np.linalg.norm(matrices, 2, axis=(1, 2)), _NEARLY_ALL))


def inverses(matrices: FloatArray) -> FloatArray:
    """Return the inverse of each matrix; NaN for all if one of them has none.

    Args:
        matrices: shape (n, m, m).
    """
    singular_values = np.linalg.svd(matrices, compute_uv=False)
    if np.any(singular_values[:, -1] <= _SINGULAR * singular_values[:, 0]):
        return np.full_like(matrices, np.nan)
    inverse: FloatArray = np.asarray(np.linalg.inv(matrices), dtype=np.float64)
    return inverse
