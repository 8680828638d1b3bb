"""The parameters of a rigid arm by least squares: few of them, so that few samples are enough."""

from __future__ import annotations

import copy
from typing import Self

import numpy as np

from tel_ros.core.learning.calibration import Calibration
from tel_ros.core.learning.held_out import (
    CHANGED,
    alternate_slices,
    arm_has_changed,
    better_strength,
)
from tel_ros.core.learning.learner import LearnerContext, StoredLearner, TrainingMode, TrainingOutcome
from tel_ros.core.learning.normal_equations import NormalEquations
from tel_ros.core.learning.one_thread import on_one_thread
from tel_ros.core.learning.rigid_body import RigidBodyRegressor
from tel_ros.core.learning.sample_memory import SampleMemory, counted, thinning
from tel_ros.core.learning.signals import TrainingSamples
from tel_ros.core.learning.sliding import stuck_trust
from tel_ros.core.learning.training_pair import outcome, rms, training_pair
from tel_ros.core.types import BoolArray, FloatArray

_FIRST_STRENGTH = 1e-4


class RigidBodyLearner:
    """The arm as rigid links with friction: u - q = K⁻¹ (B q̇ + Y π), linear in its parameters π.

    The normal equations are those of all trials; a ridge in units of each parameter's own effect keeps
    combinations out that the movements have not shown. Its strength is chosen by predicting each trial before
    learning from it.
    """

    def __init__(self, context: LearnerContext) -> None:
        self.context, self.trials_learned = context, 0
        self.changed = False
        """Whether the latest trial could not be explained together with the earlier ones."""
        self.stuck_trust = np.ones(len(context.joints))
        """How far samples of the latest trial were believed whose joint may stick. Shape (n_joints,)."""
        self._regressor = RigidBodyRegressor(context.urdf, context.joints)
        n = self._regressor.n_parameters
        self._stiffness = np.array(context.stiffness_nm_per_rad)
        self._damping = np.array(context.damping_nms_per_rad)
        self._equations = NormalEquations.empty(n)
        self._strength = _FIRST_STRENGTH
        self._parameters = np.zeros(n)
        self._calibration = Calibration.unknown(len(context.joints))

    @classmethod
    def new(cls, context: LearnerContext) -> Self:
        """Return an untrained learner.

        Raises:
            ConfigError: Pinocchio is not installed, or cannot use the URDF.
        """
        return cls(context)

    @classmethod
    def restored(cls, context: LearnerContext, stored: StoredLearner) -> Self:
        """Return a learner from its description."""
        learner = cls(context)
        learner.trials_learned = int(stored.header["trials_learned"])
        learner._strength = float(stored.header["prior_strength"])
        if not 0.0 < learner._strength < np.inf:
            raise ValueError(f"prior_strength is {learner._strength}; expected a finite number above 0")
        names = ("gram", "moment", "effect", "parameters")
        n = learner._regressor.n_parameters
        for name, shape in zip(names, ((n, n), (n,), (n,), (n,)), strict=True):
            if stored.arrays[name].shape != shape:
                raise ValueError(f"{name} has shape {stored.arrays[name].shape}; expected {shape}")
        gram, moment, effect, learner._parameters = (stored.arrays[name] for name in names)
        learner._equations = NormalEquations(gram, moment, effect)
        learner._calibration = Calibration.restored(stored.arrays, len(context.joints))
        return learner

    def stored(self) -> StoredLearner:
        """Return everything that predictions and further training depend on."""
        equations = self._equations
        arrays = {
            "gram": equations.gram,
            "moment": equations.moment,
            "effect": equations.effect,
            "parameters": self._parameters,
        }
        header = {"trials_learned": self.trials_learned, "prior_strength": self._strength}
        return StoredLearner(header, arrays | self._calibration.arrays())

    @property
    def subtrees(self) -> tuple[int, ...]:
        """Zero for each joint: there are no trees."""
        return (0,) * len(self.context.joints)

    def predict(self, inputs: FloatArray) -> FloatArray:
        """Return u - q [rad] for inputs of shape (n, 3 * n_joints). Shape (n, n_joints)."""
        if self.trials_learned == 0:
            return np.zeros((len(inputs), len(self.context.joints)))
        torque_nm = self._regressor.torque(inputs, self._parameters)
        torque_nm += self._damping * inputs[:, len(self._damping) : 2 * len(self._damping)]
        torque_nm /= self._stiffness
        return torque_nm

    def std(self, inputs: FloatArray) -> FloatArray:
        """Return the standard deviation of the error [rad]. Shape (n, n_joints)."""
        return self._calibration.std(self.leverage(inputs))

    @on_one_thread
    def leverage(self, inputs: FloatArray) -> FloatArray:
        """Return the variance of the prediction in units of that of a sample. Shape (n, n_joints)."""
        if self.trials_learned == 0:
            return np.zeros((len(inputs), len(self.context.joints)))
        inverse = np.linalg.inv(self._equations.regular(self._strength))
        rows = self._rows(inputs)
        result: FloatArray = np.einsum("njp,pq,njq->nj", rows, inverse, rows, optimize=True)
        return np.maximum(result, 0.0)

    @on_one_thread
    def trained_on(self, samples: TrainingSamples, mode: TrainingMode) -> tuple[Self, TrainingOutcome]:
        """Return a learner that has learned from one trial, and what that did; this one stays as it is.

        Raises:
            TrainingError: what was learned is not finite.
        """
        learning = self.context.learning
        new = SampleMemory.of_trial(samples, *training_pair(mode, samples, self.predict), self.trials_learned)
        learner = copy.copy(self)
        learner.trials_learned += 1
        learner.changed = False
        old = self._equations.scaled(learning.forgetting)
        sliding = samples.certain[:: thinning(samples)]
        learner.stuck_trust = self._stuck_trust(old, new, sliding)
        new = new.trusted(np.where(sliding, 1.0, learner.stuck_trust))
        added = self._equations_of(new)
        if learning.detect_change and self.trials_learned:
            error, std = counted(new.targets_rad - self.predict(new.inputs), new.trust), self.std(new.inputs)
            usual = np.sqrt(self._calibration.residual_rad2)
            learner.changed = arm_has_changed(error, std, usual, lambda: self._residuals(old, added, new))
        if learner.changed:
            old = NormalEquations.empty(len(added.moment))
            learner._strength = _FIRST_STRENGTH
        else:
            learner._strength = self._best_strength(old, new)
        learner._equations = old + added
        learner._parameters = learner._equations.solution(learner._strength)
        if self.trials_learned:
            error = new.targets_rad - self.predict(new.inputs)
            learner._calibration = self._calibration.tested(error, self.leverage(new.inputs), new.trust)
        fitted = new.targets_rad - learner.predict(new.inputs)
        learner._calibration = learner._calibration.fitted(fitted, learner.leverage(new.inputs), new.trust)
        notes = (CHANGED,) if learner.changed else ()
        return learner, outcome(self, learner, samples, notes)

    def _rows(self, inputs: FloatArray) -> FloatArray:
        """Return Y in units of the output, rad. Shape (n, n_joints, n_parameters)."""
        rows: FloatArray = self._regressor(inputs) / self._stiffness[:, None]
        return rows

    def _spring(self, inputs: FloatArray) -> FloatArray:
        n_joints = len(self.context.joints)
        offset: FloatArray = inputs[:, n_joints : 2 * n_joints] * self._damping / self._stiffness
        return offset

    def _wanted(self, data: SampleMemory) -> FloatArray:
        """Return what Y π ought to be, in units of the output, rad. Shape (n, n_joints)."""
        return data.targets_rad - self._spring(data.inputs)

    def _equations_of(self, data: SampleMemory) -> NormalEquations:
        """Return the normal equations of samples, freed of what noise in the accelerations adds to them."""
        n = self._regressor.n_parameters
        root = np.sqrt(data.trust)
        rows = (self._rows(data.inputs) * root[:, :, None]).reshape(-1, n)
        gram = rows.T @ rows
        effect = np.diag(gram).copy()
        n_joints = len(self.context.joints)
        for joint in range(n_joints):
            noise = data.noise[:, 2 * n_joints + joint]
            if np.any(noise > 0.0):
                slope = self._regressor.acceleration_slope(data.inputs, joint)
                slope *= root[:, :, None] * noise[:, None, None] / self._stiffness[:, None]
                slope = slope.reshape(-1, n)
                gram -= slope.T @ slope
        return NormalEquations(gram, rows.T @ (root * self._wanted(data)).ravel(), effect)

    def _stuck_trust(self, old: NormalEquations, new: SampleMemory, sliding: BoolArray) -> FloatArray:
        """Return how far to believe samples whose joint may stick, judged by a fit that does without them."""
        certain = old + self._equations_of(new.trusted(sliding.astype(np.float64)))
        parameters = certain.solution(self._strength)
        residual = self._wanted(new) - self._rows(new.inputs) @ parameters
        return stuck_trust(residual, sliding, parameters[-len(self._stiffness) :] / self._stiffness)

    def _residuals(
        self, old: NormalEquations, added: NormalEquations, new: SampleMemory
    ) -> tuple[FloatArray, FloatArray]:
        """Return how well the new samples are fitted with the old ones, and alone. Shapes (n_joints,)."""
        rows, wanted = self._rows(new.inputs), self._wanted(new)

        def residual(equations: NormalEquations) -> FloatArray:
            error = counted(wanted - rows @ equations.solution(self._strength), new.trust)
            result: FloatArray = np.sqrt(np.mean(error**2, axis=0))
            return result

        return residual(old + added), residual(added)

    def _best_strength(self, old: NormalEquations, new: SampleMemory) -> float:
        if self.trials_learned:
            equations, held_out = old, new
        elif len(new) == 1:  # cannot be held out and learned from
            return self._strength
        else:
            learned = alternate_slices(len(new))
            equations, held_out = self._equations_of(new[learned]), new[~learned]
        rows, wanted = self._rows(held_out.inputs), self._wanted(held_out)

        def error_with(strength: float) -> float:
            return rms(counted(wanted - rows @ equations.solution(strength), held_out.trust))

        return better_strength(self._strength, error_with)[0]
