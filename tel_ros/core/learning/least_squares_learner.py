"""Trees whose weights are solved for over all trials, alone or on top of another model."""

from __future__ import annotations

from dataclasses import replace
from typing import Self

import numpy as np
from scipy.spatial import KDTree

from tel_ros.core.errors import TrainingError
from tel_ros.core.learning.calibration import CalibratedLearner
from tel_ros.core.learning.experience import (
    CHANGED,
    CLEARLY,
    SampleMemory,
    alternate_slices,
    better_strength,
    thinning,
)
from tel_ros.core.learning.learner import LearnerContext, StoredLearner, rms
from tel_ros.core.learning.least_squares import TreeData, TreeRegression, on_one_thread
from tel_ros.core.learning.lms_tree import growth_text, new_trees, restore_trees, tree_arrays
from tel_ros.core.learning.rigid_body import RigidBodyLearner
from tel_ros.core.learning.signals import TrainingSamples
from tel_ros.core.types import BoolArray, FloatArray

BASE = "base_"
"""Begins the names of the stored arrays of the base."""
_FIRST_STRENGTH = 0.1
_NEAR, _ALIKE = 0.05, 0.3
"""How far from a sample a correction holds: in a position (1: its range), in a direction of motion [rad]."""
_AT_REST = 0.02
"""Below this speed (1: the fastest) a motion has no direction."""
_FAR = 4.0
"""Where no correction is left, in those units."""
_CALIBRATION_SAMPLES = 500
"""About so many are predicted with their leverage, which costs much more than the prediction."""


class LeastSquaresLearner(CalibratedLearner):
    """One tree a joint, its weights solved for over the samples of all trials.

    Each trial is predicted before it is learned from. This decides, joint by joint, how strong the prior is
    and whether the tree grows: only what makes the prediction of a trial not seen before clearly better is
    done. The trees correct the base, if there is one, but only near postures and directions of motion that
    were practised, at any speed: what they say elsewhere spoils what the base knows.
    """

    def __init__(self, context: LearnerContext, base: RigidBodyLearner | None = None) -> None:
        super().__init__(context)
        self.base = base
        self._joints = [TreeRegression(tree, _FIRST_STRENGTH) for tree in new_trees(context)]
        self._remember(SampleMemory.empty(len(context.joints)))

    @classmethod
    def restored(
        cls, context: LearnerContext, stored: StoredLearner, base: RigidBodyLearner | None = None
    ) -> Self:
        """Return a learner from its description."""
        learner = cls(context, base)
        learner._take_up(stored)
        learner._remember(SampleMemory.restored(stored.arrays, len(context.joints)))
        strengths = stored.header["prior_strengths"]
        if not all(0.0 < strength < np.inf for strength in strengths):
            raise ValueError(f"prior_strengths is {strengths}; expected finite numbers above 0")
        trees = restore_trees(context, stored.arrays)
        learner._joints = [TreeRegression(t, float(s)) for t, s in zip(trees, strengths, strict=True)]
        for joint, silent in zip(learner._joints, stored.header["silent"], strict=True):
            joint.gram, joint.silent = learner._gram_of(joint, learner._memory), bool(silent)
        return learner

    def stored(self) -> StoredLearner:
        """Return everything that predictions and further training depend on.

        The normal equations are not stored: they follow from the samples, to the last bit.
        """
        header: dict[str, object] = {
            "trials_learned": self.trials_learned,
            "prior_strengths": [joint.strength for joint in self._joints],
            "silent": [joint.silent for joint in self._joints],
        }
        arrays = tree_arrays([joint.tree for joint in self._joints])
        arrays |= self._memory.arrays() | self.calibration.arrays()
        if self.base is not None:
            base = self.base.stored()
            header["base"] = dict(base.header)
            arrays |= {f"{BASE}{name}": array for name, array in base.arrays.items()}
        return StoredLearner(header, arrays)

    @property
    def subtrees(self) -> tuple[int, ...]:
        """Number of subtrees of each joint's tree."""
        return tuple(joint.tree.n_subtrees for joint in self._joints)

    def predict(self, inputs: FloatArray) -> FloatArray:
        """Return u - q [rad] for inputs of shape (n, 3 * n_joints). Shape (n, n_joints)."""
        scaled = self.context.input_range.scale(inputs)
        result = self.base.predict(inputs) if self.base else np.zeros((len(inputs), len(self._joints)))
        near = self._nearness(scaled)
        for j, joint in enumerate(self._joints):
            result[:, j] += near * joint.tree.predict(scaled)
        return result

    @on_one_thread
    def leverage(self, inputs: FloatArray) -> FloatArray:
        """Return the variance of the prediction in units of that of a sample. Shape (n, n_joints)."""
        scaled = self.context.input_range.scale(inputs)
        leverage = np.column_stack([joint.leverage(scaled) for joint in self._joints])
        return leverage if self.base is None else leverage + self.base.leverage(inputs)

    @on_one_thread
    def _learn(
        self, before: Self, samples: TrainingSamples, inputs: FloatArray, targets_rad: FloatArray
    ) -> list[str]:
        learning = self.context.learning
        new = SampleMemory.of_trial(samples, inputs, targets_rad, before.trials_learned)
        old = replace(self._memory, weight=learning.forgetting * self._memory.weight)
        self._joints = [joint.copy() for joint in self._joints]
        for joint in self._joints:
            joint.gram *= learning.forgetting
        notes: list[str] = []
        if self.base is not None:
            pair = replace(samples, actual=inputs, offset_rad=targets_rad)
            self.base, told = self.base.trained_on(pair, "actual")
            notes += told.grown
            new = replace(new, trust=self._trust(samples.certain[:: thinning(samples)]))
        if CHANGED in notes:
            old = self._start_over()
        elif before._is_contradicted(new, lambda: self._residuals(old, new)):
            old = self._start_over()
            notes.append(CHANGED)
        if len(old) or len(new) > 1:  # a single sample cannot be held out and learned from
            notes += self._choose(old, new)
        for earlier, joint in zip(before._joints, self._joints, strict=True):
            if learning.forgetting != 1.0 or joint.tree.n_subtrees != earlier.tree.n_subtrees:
                joint.set_gram(self._gram_of(joint, old))
        self._fit(old, new)
        rows = slice(None, None, max(1, len(samples.actual) // _CALIBRATION_SAMPLES))
        trust = self._trust(samples.certain[rows])
        self._calibrate(before, samples.actual[rows], samples.offset_rad[rows], trust)
        if not all(np.all(np.isfinite(joint.tree.weights)) for joint in self._joints):
            raise TrainingError("the weights did not stay finite; the network is unchanged")
        return notes

    def _remember(self, memory: SampleMemory) -> None:
        self._memory = memory
        self._motions = KDTree(self._motions_of(self.context.input_range.scale(memory.inputs)))

    def _motions_of(self, scaled: FloatArray) -> FloatArray:
        """Return postures and directions of motion in units in which a correction holds as far as 1."""
        n = len(self._joints)
        velocity = 2.0 * scaled[:, n : 2 * n] - 1.0
        speed = np.linalg.norm(velocity, axis=1, keepdims=True)
        return np.hstack([scaled[:, :n] / _NEAR, velocity / (speed + _AT_REST) / _ALIKE])

    def _nearness(self, scaled: FloatArray) -> FloatArray | float:
        """Return 1 where the trees have seen samples, falling to 0 where they have not. Shape (n,)."""
        if self.base is None:
            return 1.0
        distance, _ = self._motions.query(self._motions_of(scaled), distance_upper_bound=_FAR)
        return np.asarray(np.exp(-0.5 * distance**2), dtype=np.float64)

    def _trust(self, sliding: BoolArray) -> FloatArray:
        """Return how far samples of the latest trial are to be believed. Shape (n, n_joints)."""
        if self.base is None:  # trees cannot separate dry friction from other torques
            return np.ones(sliding.shape)
        return np.where(sliding, 1.0, self.base.stuck_trust)

    def _tree_data(self, memory: SampleMemory) -> TreeData:
        range_ = self.context.input_range
        return TreeData(range_.scale(memory.inputs), memory.noise / range_.width, memory.weight)

    def _data(self, memory: SampleMemory) -> tuple[TreeData, FloatArray]:
        """Return samples in the units of the trees, and what the trees should say there, (n, n_joints).

        A target is shrunk to zero as far as it cannot be believed, which leaves the prediction to the base: a
        tree that never sees such a sample could say anything there.
        """
        wanted = memory.targets_rad
        if self.base is not None:
            wanted = memory.trust * (wanted - self.base.predict(memory.inputs))
        return self._tree_data(memory), wanted

    def _start_over(self) -> SampleMemory:
        """Forget all samples and return the memory that is left; the trees keep their form."""
        for joint in self._joints:
            joint.gram = np.zeros_like(joint.gram)
            joint.strength = _FIRST_STRENGTH
        return SampleMemory.empty(len(self.context.joints))

    def _choose(self, old: SampleMemory, new: SampleMemory) -> list[str]:
        """Find for each joint the prior and the tree that predict the new samples best from the old ones."""
        learned, held_out = old, new
        if len(old) == 0:
            chosen = alternate_slices(len(new))
            learned, held_out = new[chosen], new[~chosen]
        (data, y), (test_data, test_y) = self._data(learned), self._data(held_out)
        learning, notes = self.context.learning, []
        for j, joint in enumerate(self._joints):
            if len(old) == 0:
                joint.gram = joint.gram_of(data)
            joint.silent = False
            moment = joint.moment_of(data, y[:, j])

            def residual(tried: TreeRegression, y: FloatArray = test_y[:, j]) -> FloatArray:
                return y - tried.tree.predict(test_data.inputs)

            def error_with(strength: float, joint: TreeRegression = joint, b: FloatArray = moment) -> float:
                joint.strength = strength
                joint.solve(b)
                return rms(residual(joint))

            joint.strength, error = better_strength(joint.strength, error_with)
            joint.solve(moment)
            for _ in range(min(learning.growth_per_trial, learning.max_subtrees - joint.tree.n_subtrees)):
                variance = joint.tree.change_variance(test_data.inputs, residual(joint))
                leaf = joint.tree.most_pulled_leaf(variance)
                grown = joint.copy()
                grown.grow(leaf, data)
                grown.solve(grown.moment_of(data, y[:, j]))
                if rms(residual(grown)) > CLEARLY * error:
                    break
                joint = self._joints[j] = grown
                error = rms(residual(joint))
                notes.append(growth_text(self.context.joints, j, joint.tree.n_subtrees, leaf))
            joint.silent = self.base is not None and error > CLEARLY * rms(test_y[:, j])
            if len(old) == 0:
                joint.gram[:] = 0.0
        return notes

    def _fit(self, old: SampleMemory, new: SampleMemory) -> None:
        (new_data, new_y), (old_data, old_y) = self._data(new), self._data(old)
        for j, joint in enumerate(self._joints):
            joint.gram = joint.gram + joint.gram_of(new_data)
            joint.solve(joint.moment_of(old_data, old_y[:, j]) + joint.moment_of(new_data, new_y[:, j]))
        memory = old.joined(new)
        self._remember(memory.bounded(self.context.learning.memory_samples))
        if self._memory is not memory:
            for joint in self._joints:
                joint.set_gram(self._gram_of(joint, self._memory))

    @on_one_thread
    def _gram_of(self, joint: TreeRegression, memory: SampleMemory) -> FloatArray:
        """Return the normal equations of a memory, summed up trial by trial.

        That is the order in which they are summed up while trials come. So a learner that was stored goes on
        as if it had not been, down to rounding.
        """
        gram = np.zeros_like(joint.gram)
        for trial in np.unique(memory.trial):
            gram = gram + joint.gram_of(self._tree_data(memory[memory.trial == trial]))
        return gram

    def _residuals(self, old: SampleMemory, new: SampleMemory) -> tuple[FloatArray, FloatArray]:
        """Return how well the new samples are fitted with the old ones, and alone. Shapes (n_joints,)."""
        (new_data, new_y), (old_data, old_y) = self._data(new), self._data(old)
        residuals = np.zeros((2, len(self._joints)))
        for j, joint in enumerate(self._joints):
            moment_old = joint.moment_of(old_data, old_y[:, j])
            moment_new, gram_new = joint.moment_of(new_data, new_y[:, j]), joint.gram_of(new_data)
            for k, weight in enumerate((1.0, 0.0)):
                fit = joint.copy()
                fit.gram = weight * joint.gram + gram_new
                fit.solve(weight * moment_old + moment_new)
                residuals[k, j] = rms(new_y[:, j] - fit.tree.predict(new_data.inputs))
        return residuals[0], residuals[1]
