"""How far predictions can be believed, measured by trials that were predicted before they were learned."""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from tel_ros.core.learning.experience import SampleMemory, arm_has_changed, counted
from tel_ros.core.learning.learner import (
    LearnerContext,
    StoredLearner,
    TrainingMode,
    TrainingOutcome,
    outcome,
    training_pair,
)
from tel_ros.core.learning.signals import TrainingSamples
from tel_ros.core.types import FloatArray

_MEMORY = 0.5
"""Weight of a test relative to the next one."""
_LEAST_LEVERAGE = 1e-12


@dataclass(frozen=True)
class Calibration:
    """Standard deviation of predictions from their leverage: std² = σ² + s² h(x), per joint.

    The leverage h = ψᵀ A⁻¹ ψ shows where data are missing, but not how wrong the form of the model is. So s²
    is measured: each new trial is predicted before it is learned from, and s² is the ratio of its squared
    errors to its leverage. σ² is what remains after fitting.

    Shapes (n_joints,).
    """

    residual_rad2: FloatArray
    """σ²."""
    scale_rad2: FloatArray
    """s²."""

    @classmethod
    def unknown(cls, n_joints: int) -> Self:
        """Return that of an untrained learner: its errors may be of any size."""
        return cls(np.full(n_joints, np.inf), np.full(n_joints, np.inf))

    @classmethod
    def restored(cls, arrays: Mapping[str, np.ndarray], n_joints: int) -> Self:
        """Return a calibration from its arrays; raise ValueError if they cannot be one."""
        residual, scale = arrays["calibration_residual"], arrays["calibration_scale"]
        if residual.size == scale.size == 0:
            return cls.unknown(n_joints)
        for values in (residual, scale):
            if values.shape != (n_joints,) or not np.all(values >= 0.0):
                raise ValueError(f"a calibration is {values}; expected {n_joints} numbers of at least 0")
        return cls(residual, scale)

    def arrays(self) -> dict[str, np.ndarray]:
        """Return it as arrays of finite numbers, empty if it is not known."""
        if not self.is_known:
            return {"calibration_residual": np.empty(0), "calibration_scale": np.empty(0)}
        return {"calibration_residual": self.residual_rad2, "calibration_scale": self.scale_rad2}

    @property
    def is_known(self) -> bool:
        """Whether there was a trial to measure it."""
        return bool(np.all(np.isfinite(self.residual_rad2)))

    def std(self, leverage: FloatArray) -> FloatArray:
        """Return standard deviations [rad] for leverages of shape (n, n_joints)."""
        if not self.is_known:
            return np.full(leverage.shape, np.inf)
        return np.sqrt(self.residual_rad2 + self.scale_rad2 * leverage)

    def tested(self, error_rad: FloatArray, leverage: FloatArray, trust: FloatArray | None = None) -> Self:
        """Return it after a test: errors at samples that had not been learned from.

        All of shape (n, n_joints). ``trust`` is the weight of each sample; None: all the same.
        """
        noise = np.where(np.isfinite(self.residual_rad2), self.residual_rad2, 0.0)
        excess = np.maximum(_mean(error_rad**2, trust) - noise, 0.0)
        found = excess / np.maximum(_mean(leverage, trust), _LEAST_LEVERAGE)
        before = np.where(np.isfinite(self.scale_rad2), self.scale_rad2, found)
        return replace(self, scale_rad2=_MEMORY * before + (1.0 - _MEMORY) * found)

    def fitted(self, residual_rad: FloatArray, leverage: FloatArray, trust: FloatArray | None = None) -> Self:
        """Return it after training: errors that remain at the samples that were learned from."""
        residual = _mean(residual_rad**2, trust)
        # Before the first test the scale is guessed from the residual.
        guess = residual / np.maximum(_mean(leverage, trust), _LEAST_LEVERAGE)
        scale = np.where(np.isfinite(self.scale_rad2), self.scale_rad2, guess)
        return replace(self, residual_rad2=residual, scale_rad2=scale)


def _mean(values: FloatArray, trust: FloatArray | None) -> FloatArray:
    return np.asarray(np.average(values, axis=0, weights=trust), dtype=np.float64)


class CalibratedLearner(ABC):
    """What our learners share: each trial is predicted before it is learned, which calibrates the learner."""

    def __init__(self, context: LearnerContext) -> None:
        self.context, self.trials_learned = context, 0
        self.calibration = Calibration.unknown(len(context.joints))

    def _take_up(self, stored: StoredLearner) -> None:
        self.trials_learned = int(stored.header["trials_learned"])
        self.calibration = Calibration.restored(stored.arrays, len(self.context.joints))

    @abstractmethod
    def stored(self) -> StoredLearner:
        """Return everything that predictions and further training depend on."""

    @property
    def subtrees(self) -> tuple[int, ...]:
        """Number of subtrees of each joint's tree."""
        return (0,) * len(self.context.joints)

    @abstractmethod
    def predict(self, inputs: FloatArray) -> FloatArray:
        """Return u - q [rad] for inputs of shape (n, 3 * n_joints). Shape (n, n_joints)."""

    @abstractmethod
    def leverage(self, inputs: FloatArray) -> FloatArray:
        """Return the variance of the prediction in units of that of a sample. Shape (n, n_joints)."""

    @abstractmethod
    def _learn(
        self, before: Self, samples: TrainingSamples, inputs: FloatArray, targets_rad: FloatArray
    ) -> list[str]:
        """Learn what to say at some inputs; return what grew or was noticed, in words.

        This learner is a copy of the one before, which must not change: arrays and trees are shared.
        """

    @np.errstate(over="ignore", invalid="ignore")  # what does not stay finite is refused
    def trained_on(self, samples: TrainingSamples, mode: TrainingMode) -> tuple[Self, TrainingOutcome]:
        """See :meth:`.learner.Learner.trained_on`."""
        inputs, targets_rad = training_pair(mode, samples, self.predict)
        learner = copy.copy(self)
        learner.trials_learned += 1
        notes = learner._learn(self, samples, inputs, targets_rad)
        return learner, outcome(self, learner, samples, tuple(notes))

    def std(self, inputs: FloatArray) -> FloatArray:
        """Return the standard deviation of the error [rad]; inf where nothing is known."""
        if not self.calibration.is_known:
            return np.full((len(inputs), len(self.context.joints)), np.inf)
        return self.calibration.std(self.leverage(inputs))

    def _calibrate(
        self, before: Self, inputs: FloatArray, offset_rad: FloatArray, trust: FloatArray | None = None
    ) -> None:
        """Measure how good the predictions of the learner before were, and how well this one fits."""
        calibration = before.calibration
        if before.trials_learned:
            error = offset_rad - before.predict(inputs)
            calibration = calibration.tested(error, before.leverage(inputs), trust)
        self.calibration = calibration.fitted(offset_rad - self.predict(inputs), self.leverage(inputs), trust)

    def _is_contradicted(
        self, new: SampleMemory, residuals: Callable[[], tuple[FloatArray, FloatArray]]
    ) -> bool:
        """Return whether a trial shows another arm than the earlier ones; see :func:`arm_has_changed`."""
        if not (self.context.learning.detect_change and self.trials_learned):
            return False
        error = counted(new.targets_rad - self.predict(new.inputs), new.trust)
        return arm_has_changed(
            error, self.std(new.inputs), np.sqrt(self.calibration.residual_rad2), residuals
        )
