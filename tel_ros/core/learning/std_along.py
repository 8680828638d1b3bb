"""The uncertainty of a learner along a movement."""

from __future__ import annotations

import numpy as np

from tel_ros.core.learning.learner import Learner
from tel_ros.core.types import FloatArray

_POINTS = 225


def std_along(learner: Learner, inputs: FloatArray) -> FloatArray:
    """Return the standard deviation of the command's error [rad] at all points of a movement.

    It is asked for at some of the points only: it costs much more than the prediction, and changes as
    slowly as the movement.

    Args:
        learner: who is asked.
        inputs: along the movement. Shape (n, 3 * n_joints).

    Returns:
        Shape (n, n_joints); inf where nothing is known.
    """
    step = max(1, len(inputs) // _POINTS)
    asked = np.unique(np.append(np.arange(0, len(inputs), step), len(inputs) - 1))
    std = learner.std(inputs[asked])
    return np.column_stack([np.interp(np.arange(len(inputs)), asked, column) for column in std.T])
