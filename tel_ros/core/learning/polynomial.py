"""Inverse dynamics of an arm of rigid links whose kinematics are not known."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import NamedTuple, Self

import numpy as np

from tel_ros.core.errors import ConfigError
from tel_ros.core.learning.calibration import CalibratedLearner
from tel_ros.core.learning.energy_process import (
    FIRST_SHAPE,
    EnergyKernel,
    Features,
    Posterior,
    Prior,
    Samples,
)
from tel_ros.core.learning.experience import CHANGED, SampleMemory, counted, stuck_trust, thinning
from tel_ros.core.learning.learner import LearnerContext, StoredLearner
from tel_ros.core.learning.least_squares import on_one_thread
from tel_ros.core.learning.signals import TrainingSamples
from tel_ros.core.types import BoolArray, FloatArray
from tel_ros.core.urdf import Urdf

_MOST_OUTPUTS = 12_000
"""Samples times joints that are remembered."""
_TESTED = 200
"""About so many samples of a trial are predicted with their variance, which costs much more."""
_LEAST_SCALE = 4.0
"""Of the variance: errors of neighbours are more alike than those of white noise, for which it would be 1."""
_HARDLY = 1e-6
"""Weight of samples that are to be done without."""


class _Learned(NamedTuple):
    """What some samples have taught."""

    memory: SampleMemory
    new: SampleMemory
    """Those of the latest trial, with the trust that was found."""
    prior: Prior
    posterior: Posterior


class PolynomialLearner(CalibratedLearner):
    """u - q = K⁻¹ (B q̇ + τ), with a Gaussian process for τ (:mod:`.energy_process`).

    Of the URDF, if there is one, it takes which joints slide and in which order they carry each other;
    without one all turn, and each carries the next. The torque is exactly affine in q̈, and quadratic in q̇
    but for Coulomb friction.
    """

    def __init__(self, context: LearnerContext) -> None:
        super().__init__(context)
        n = len(context.joints)
        order, slides = np.arange(n), np.zeros(n, dtype=np.bool_)
        if context.urdf:
            urdf = Urdf(context.urdf.encode(), "the URDF")
            if missing := [joint for joint in context.joints if joint not in urdf.joints]:
                raise ConfigError("name", "polynomial", f"a URDF with {', '.join(missing)}, or none")
            links = urdf.below(urdf.root)
            order = np.argsort([links.index(urdf.joints[joint].child) for joint in context.joints])
            slides = np.array([urdf.joints[joint].kind == "prismatic" for joint in context.joints])
        low, high = context.input_range.low[:n], context.input_range.high[:n]
        middle, scale = np.where(slides, 0.5 * (low + high), 0.0), np.where(slides, 0.5 * (high - low), 1.0)
        self._stiffness = np.array(context.stiffness_nm_per_rad)
        self._damping = np.array(context.damping_nms_per_rad)
        unit = scale * self._stiffness
        self._kernel = EnergyKernel(order, slides[order], middle[order], scale[order], unit[order])
        self._back = np.argsort(order)
        self._memory = SampleMemory.empty(n)
        self._prior: Prior | None = None
        self._posterior: Posterior | None = None

    @classmethod
    def restored(cls, context: LearnerContext, stored: StoredLearner) -> Self:
        """Return a learner from its description."""
        learner = cls(context)
        learner._take_up(stored)
        n = len(context.joints)
        learner._memory = SampleMemory.restored(stored.arrays, n)
        if len(learner._memory):
            # Networks from before shapes were learned have none.
            arrays = {"prior_shape": np.full(n, FIRST_SHAPE)} | dict(stored.arrays)
            known = {field.name: arrays[f"prior_{field.name}"] for field in fields(Prior)}
            for name, values in known.items():
                if values.shape != (n,) or not np.all(values > 0.0):
                    raise ValueError(f"prior_{name} is {values}; expected {n} numbers above 0")
            learner._prior = Prior(**known)
            learner._posterior = learner._fitted(learner._memory, learner._prior)
        return learner

    def stored(self) -> StoredLearner:
        """Return everything that predictions and further training depend on: the samples and the prior.

        All else follows from them, to the last bit.
        """
        prior = {f"prior_{name}": values for name, values in vars(self._prior).items()} if self._prior else {}
        arrays = self._memory.arrays() | prior | self.calibration.arrays()
        return StoredLearner({"trials_learned": self.trials_learned}, arrays)

    @on_one_thread
    def predict(self, inputs: FloatArray) -> FloatArray:
        """Return u - q [rad] for inputs of shape (n, 3 * n_joints). Shape (n, n_joints)."""
        if self._posterior is None:
            return np.zeros((len(inputs), len(self.context.joints)))
        mean: FloatArray = self._posterior.mean(self._kernel.states(inputs))[:, self._back]
        return mean + self._springs(inputs)

    @on_one_thread
    def leverage(self, inputs: FloatArray) -> FloatArray:
        """Return the variance of the prediction. Shape (n, n_joints)."""
        if self._posterior is None:
            return np.zeros((len(inputs), len(self.context.joints)))
        return self._posterior.variance(self._kernel.states(inputs))[:, self._back]

    @on_one_thread
    def _learn(
        self, before: Self, samples: TrainingSamples, inputs: FloatArray, targets_rad: FloatArray
    ) -> list[str]:
        learning, n = self.context.learning, len(self._damping)
        most = min(learning.memory_samples, _MOST_OUTPUTS // n)
        new = SampleMemory.of_trial(samples, inputs, targets_rad, before.trials_learned)
        sliding = samples.certain[:: thinning(samples)]
        old = replace(self._memory, weight=learning.forgetting * self._memory.weight)
        learned = self._learned(old, new, sliding, most)
        alone: list[_Learned] = []

        def residuals() -> tuple[FloatArray, FloatArray]:
            alone.append(self._learned(SampleMemory.empty(n), new, sliding, most))
            return self._residual(learned), self._residual(alone[0])

        changed = before._is_contradicted(learned.new, residuals)
        if changed:
            learned = alone[0]
        self._memory, new, self._prior, self._posterior = learned
        tested = new[:: max(1, len(new) // _TESTED)]
        self._calibrate(before, tested.inputs, tested.targets_rad, tested.trust)
        scale = np.maximum(self.calibration.scale_rad2, _LEAST_SCALE)
        self.calibration = replace(self.calibration, scale_rad2=scale)
        return [CHANGED] if changed else []

    def _learned(self, old: SampleMemory, new: SampleMemory, sliding: BoolArray, most: int) -> _Learned:
        """Return what two sets of samples teach; where a joint may stick is judged by a fit without."""
        certain = np.where(sliding | ~sliding.any(axis=0), 1.0, _HARDLY)
        memory = old.joined(replace(new, trust=certain)).bounded(most)
        data = self._samples(memory)
        prior = self._kernel.tuned(self._prior if len(old) else None, data)
        features = Features(self._kernel, prior, data)
        rows = features(data.states)
        fit = Posterior(features, rows, data)
        if not sliding.all():
            trust = stuck_trust(self._residual_of(fit, new), sliding, fit.coulomb[self._back])
            new = replace(new, trust=np.where(sliding, 1.0, trust))
            memory = old.joined(new).bounded(most)
            fit = Posterior(features, rows, self._samples(memory))
        return _Learned(memory, new, prior, fit)

    @on_one_thread
    def _fitted(self, memory: SampleMemory, prior: Prior) -> Posterior:
        data = self._samples(memory)
        features = Features(self._kernel, prior, data)
        return Posterior(features, features(data.states), data)

    def _samples(self, memory: SampleMemory) -> Samples:
        order = self._kernel.order
        outputs = (memory.targets_rad - self._springs(memory.inputs))[:, order]
        weight = (memory.trust * memory.weight[:, None])[:, order]
        return Samples(self._kernel.states(memory.inputs), outputs, weight)

    def _springs(self, inputs: FloatArray) -> FloatArray:
        """Return B q̇ / K."""
        n = len(self._damping)
        return np.asarray(inputs[:, n : 2 * n] * self._damping / self._stiffness, dtype=np.float64)

    def _residual_of(self, fit: Posterior, data: SampleMemory) -> FloatArray:
        mean = fit.mean(self._kernel.states(data.inputs))[:, self._back]
        return np.asarray(data.targets_rad - self._springs(data.inputs) - mean, dtype=np.float64)

    def _residual(self, learned: _Learned) -> FloatArray:
        """Return the RMS error of a fit at the latest trial. Shape (n_joints,)."""
        error = counted(self._residual_of(learned.posterior, learned.new), learned.new.trust)
        return np.asarray(np.sqrt(np.mean(error**2, axis=0)), dtype=np.float64)
