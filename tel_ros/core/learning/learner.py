"""What every learner of inverse dynamics can do: the contract between practice and learning.

A learner is a value: training returns another one. So whatever goes wrong in training, the learner that
answered before still does. Learners are found by name (:mod:`.registry`); another package offers one as an
entry point of the group ``tel_ros.learners`` that names a :class:`LearnerKind`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal, Protocol, Self

import numpy as np

from tel_ros.core.config import LearningConfig
from tel_ros.core.errors import TrainingError
from tel_ros.core.learning.inputs import InputRange
from tel_ros.core.learning.signals import TrainingSamples
from tel_ros.core.types import FloatArray

TrainingMode = Literal["actual", "desired"]
Predicts = Literal["equilibrium", "torque"]
_RMS_SAMPLES = 1000
_STD_POINTS = 225


@dataclass(frozen=True)
class LearnerContext:
    """What a learner is told about the arm that it learns.

    Args:
        joints: in the order of all arrays.
        stiffness_nm_per_rad: K of the EP control law, as B one a joint.
        input_range: of the 3 * n_joints inputs: what the goal movement covers.
        urdf: text of the URDF; its kinematics can be trusted, its inertias need not be right. May be empty.
        predicts: ``equilibrium``: K and B are the springs of practice. ``torque``: there are no springs; the
            output is a torque in units of K, and B is 0.
        std_factor: of a torque: how many times larger errors were, where they could be tested, than the
            learner expected; one a joint. Empty: not known.
    """

    joints: tuple[str, ...]
    stiffness_nm_per_rad: tuple[float, ...]
    damping_nms_per_rad: tuple[float, ...]
    input_range: InputRange
    learning: LearningConfig
    seed: int
    urdf: str = ""
    predicts: Predicts = "equilibrium"
    std_factor: tuple[float, ...] = ()


@dataclass(frozen=True)
class TrainingOutcome:
    """What training on one trial did."""

    training_rms_before_rad: float
    """RMS over all joints of û - N(ŷ) before training."""
    training_rms_after_rad: float
    rms_command_change_rad: float
    """RMS change of the command for the trial's own desired trajectory."""
    grown: tuple[str, ...]
    """What grew or was noticed, in words."""


@dataclass(frozen=True)
class StoredLearner:
    """A learner as it goes into a file: values that JSON holds, and arrays of numbers."""

    header: Mapping[str, Any]
    arrays: Mapping[str, np.ndarray]


class LearnerKind(Protocol):
    """How learners of one kind come into being; what an entry point names."""

    def new(self, context: LearnerContext) -> Learner:
        """Return an untrained learner: its prediction is 0, so that the EP is the desired position.

        Raises:
            ConfigError: the context asks for what this learner cannot do.
        """
        ...

    def restored(self, context: LearnerContext, stored: StoredLearner) -> Learner:
        """Return the learner that :meth:`Learner.stored` described.

        Raises:
            ValueError: the description does not fit together, or holds numbers that are not finite.
        """
        ...


class Learner(Protocol):
    """Learned inverse dynamics N: from (q, q̇, q̈) of all joints to the offset u - q of the equilibrium point.

    Inputs have shape (n, 3 * n_joints), in SI units; outputs (n, n_joints), in rad. Untrained it gives 0: the
    equilibrium point is the desired position, which is right at low speed ([Practice] Sec. 2.2).
    """

    context: LearnerContext
    trials_learned: int

    @property
    def subtrees(self) -> tuple[int, ...]:
        """Size of each joint's tree; zeros for a learner without trees."""
        ...

    def predict(self, inputs: FloatArray) -> FloatArray:
        """Return u - q [rad]."""
        ...

    def std(self, inputs: FloatArray) -> FloatArray:
        """Return the standard deviation [rad] of the error of :meth:`predict`; inf where nothing is known."""
        ...

    def trained_on(self, samples: TrainingSamples, mode: TrainingMode) -> tuple[Self, TrainingOutcome]:
        """Return a learner that has learned from one trial, and what that did; this one stays as it is.

        ``mode`` is where to apply the command error (see :func:`training_pair`).

        Raises:
            TrainingError: the samples cannot be learned from, or what was learned is not finite.
        """
        ...

    def stored(self) -> StoredLearner:
        """Return everything that predictions and further training depend on."""
        ...


def training_pair(
    mode: TrainingMode, samples: TrainingSamples, predict: Callable[[FloatArray], FloatArray]
) -> tuple[FloatArray, FloatArray]:
    """Return the inputs to train the network at, and what it should say there.

    Only the command û that was sent has a known outcome ŷ, so the error is always δ = û - N(ŷ). ``actual``
    removes it at ŷ, ``desired`` changes the output at y by the same δ ([Practice] Sec. 2.1 and Fig. 1;
    convergence by Theorems 2 and 1). δ is that of the network before training, as in Theorem 1. The targets
    are in rad, of shape (n, n_joints).

    Raises:
        TrainingError: a sample is not finite.
    """
    for name in ("actual", "desired", "offset_rad"):
        if not np.all(np.isfinite(getattr(samples, name))):
            raise TrainingError(f"{name} has values that are not finite; the network is unchanged")
    if mode == "actual":
        return samples.actual, samples.offset_rad
    return samples.desired, predict(samples.desired) + samples.offset_rad - predict(samples.actual)


def outcome(
    before: Learner, after: Learner, samples: TrainingSamples, grown: tuple[str, ...]
) -> TrainingOutcome:
    """Return what training on a trial has changed.

    Raises:
        TrainingError: a figure is not finite; ``after`` must not be used then.
    """
    rows = slice(None, None, max(1, len(samples.offset_rad) // _RMS_SAMPLES))
    desired, actual, offset_rad = samples.desired[rows], samples.actual[rows], samples.offset_rad[rows]
    rms_rad = (
        rms(offset_rad - before.predict(actual)),
        rms(offset_rad - after.predict(actual)),
        rms(after.predict(desired) - before.predict(desired)),
    )
    if not all(map(math.isfinite, rms_rad)):
        raise TrainingError(f"the RMS errors {rms_rad} rad are not finite; the network is unchanged")
    return TrainingOutcome(*rms_rad, grown=grown)


def rms(values: FloatArray) -> float:
    """Return the root of the mean square of all values."""
    return float(np.sqrt(np.mean(values**2)))


def std_along(learner: Learner, inputs: FloatArray) -> FloatArray:
    """Return the standard deviation of the command's error [rad] along a movement; inf where not known.

    It costs much more than the prediction and changes as slowly as the movement: it is interpolated between
    some of the points. Input shape (n, 3 * n_joints), output shape (n, n_joints).
    """
    step = max(1, len(inputs) // _STD_POINTS)
    asked = np.unique(np.append(np.arange(0, len(inputs), step), len(inputs) - 1))
    std = learner.std(inputs[asked])
    return np.column_stack([np.interp(np.arange(len(inputs)), asked, column) for column in std.T])
