"""Torque from a learner, and whether the learner can know it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tel_ros.core.learning.learner import Learner
from tel_ros.core.types import BoolArray, FloatArray

UNCERTAIN = 0.5
"""Standard deviation, in units of the spread of the recorded torque, from which on a prediction says little:
a guess without any learning has 1."""
_ROUNDING = 1e-9
_PORTION = 1000
"""Queries at a time: the standard deviation of a rigid arm needs all of its regressor."""


@dataclass(frozen=True)
class TorquePrediction:
    """What a learner says of some states of motion.

    Args:
        torque_nm: shape (n, n_joints).
        std_nm: standard deviation of its error, in the measure of those that were tested; inf where nothing
            is known. Shape (n, n_joints).
        outside: which inputs are outside of what the learner was made for. Shape (n, 3 * n_joints).
        uncertain: where the standard deviation is near that of a guess. Shape (n, n_joints).
    """

    torque_nm: FloatArray
    std_nm: FloatArray
    outside: BoolArray
    uncertain: BoolArray

    @property
    def extrapolated(self) -> BoolArray:
        """Where it is a guess in one respect or the other. Shape (n,)."""
        return np.asarray(self.outside.any(axis=1) | self.uncertain.any(axis=1), dtype=np.bool_)


def predict_torque(learner: Learner, inputs: FloatArray) -> TorquePrediction:
    """Ask a learner for torques: τ = K N(q, q̇, q̈) - B q̇, with the K and B that it has learned with.

    Of a learner of torque K is the spread of the recorded torques, and B is 0. A learner of equilibrium
    points does not know how large torques usually are; there only an unbounded standard deviation counts as
    uncertain.

    Args:
        learner: of torque or of equilibrium points.
        inputs: q, q̇, q̈. Shape (n, 3 * n_joints).
    """
    context = learner.context
    stiffness, damping = np.array(context.stiffness_nm_per_rad), np.array(context.damping_nms_per_rad)
    n_joints = len(context.joints)
    velocity = inputs[:, n_joints : 2 * n_joints]
    std = np.vstack(
        [learner.std(inputs[k : k + _PORTION]) for k in range(0, len(inputs), _PORTION)]
        or [np.empty((0, n_joints))]
    )
    std *= np.array(context.std_factor or (1.0,) * n_joints)
    allowed = UNCERTAIN if context.predicts == "torque" else np.finfo(np.float64).max
    range_ = context.input_range
    slack = _ROUNDING * (range_.high - range_.low)
    return TorquePrediction(
        torque_nm=stiffness * learner.predict(inputs) - damping * velocity,
        std_nm=stiffness * std,
        outside=(inputs < range_.low - slack) | (inputs > range_.high + slack),
        uncertain=~(std <= allowed),
    )
