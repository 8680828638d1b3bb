"""What every learner of inverse dynamics can do: the contract between practice and learning.

A learner is a value: it never changes, and training returns another one. So whatever goes wrong in training,
the learner that answered before still does. Learners are found by name; a package of a user's own offers one
as an entry point of the group ``tel_ros.learners`` that names a :class:`LearnerKind`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, Protocol, Self

import numpy as np

from tel_ros.core.config import LearningConfig
from tel_ros.core.learning.inputs import InputRange
from tel_ros.core.learning.signals import TrainingSamples
from tel_ros.core.types import FloatArray

TrainingMode = Literal["actual", "desired"]
Predicts = Literal["equilibrium", "torque"]


@dataclass(frozen=True)
class LearnerContext:
    """What a learner is told about the arm that it learns.

    Args:
        joints: names, in the order of all arrays.
        stiffness_nm_per_rad: K of the EP control law. Shape (n_joints,).
        damping_nms_per_rad: B of the EP control law. Shape (n_joints,).
        input_range: ranges of the 3 * n_joints inputs that the goal movement covers.
        learning: size and method.
        seed: of everything random.
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
    """What training on one trial did.

    Args:
        rms_before_rad: RMS over all joints of û - N(ŷ) before training.
        rms_after_rad: the same after it.
        rms_command_change_rad: RMS change of the command for the trial's own desired trajectory.
        grown: what grew or was noticed, in words.
    """

    rms_before_rad: float
    rms_after_rad: float
    rms_command_change_rad: float
    grown: tuple[str, ...]


@dataclass(frozen=True)
class StoredLearner:
    """A learner as it goes into a file.

    Args:
        header: values that JSON can hold.
        arrays: numbers by name; no objects.
    """

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

    Inputs have shape (n, 3 * n_joints), in SI units; outputs (n, n_joints), in rad.
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
        """Return a learner that has learned from one trial, and what that did.

        Args:
            samples: the trial.
            mode: where to apply the command error (see :func:`~.training_pair.training_pair`).

        Raises:
            TrainingError: the samples cannot be learned from, or what was learned is not finite.
        """
        ...

    def stored(self) -> StoredLearner:
        """Return everything that predictions and further training depend on."""
        ...
