"""The paper's learner: LMS trees that learn sample by sample, from one trial at a time."""

from __future__ import annotations

import copy
from typing import Self

import numpy as np

from tel_ros.core.errors import TrainingError
from tel_ros.core.learning.calibration import CalibratedLearner
from tel_ros.core.learning.learner import LearnerContext, StoredLearner
from tel_ros.core.learning.lms_tree import LmsTree, growth_text, new_trees, restore_trees, tree_arrays
from tel_ros.core.learning.signals import TrainingSamples
from tel_ros.core.types import FloatArray


class LmsLearner(CalibratedLearner):
    """One LMS tree a joint; see :class:`~.learner.Learner`."""

    def __init__(self, context: LearnerContext) -> None:
        super().__init__(context)
        self._trees = new_trees(context)
        self._seen = [np.zeros_like(tree.weights) for tree in self._trees]
        """Σ ψ² of each weight: how often and how strongly it has been used in learning."""

    @classmethod
    def restored(cls, context: LearnerContext, stored: StoredLearner) -> Self:
        """Return a learner from its description."""
        learner = cls(context)
        learner._take_up(stored)
        learner._trees = restore_trees(context, stored.arrays)
        learner._seen = [stored.arrays[f"seen_{j}"] for j in range(len(context.joints))]
        if any(s.shape != t.weights.shape for s, t in zip(learner._seen, learner._trees, strict=True)):
            raise ValueError("seen_… does not have the shape of the weights")
        return learner

    def stored(self) -> StoredLearner:
        """Return everything that predictions and further training depend on."""
        arrays = tree_arrays(self._trees) | self.calibration.arrays()
        arrays |= {f"seen_{j}": seen for j, seen in enumerate(self._seen)}
        return StoredLearner({"trials_learned": self.trials_learned}, arrays)

    @property
    def subtrees(self) -> tuple[int, ...]:
        """Number of subtrees of each joint's tree."""
        return tuple(tree.n_subtrees for tree in self._trees)

    def predict(self, inputs: FloatArray) -> FloatArray:
        """Return u - q [rad] for inputs of shape (n, 3 * n_joints). Shape (n, n_joints)."""
        scaled = self.context.input_range.scale(inputs)
        return np.column_stack([tree.predict(scaled) for tree in self._trees])

    def leverage(self, inputs: FloatArray) -> FloatArray:
        """Return the variance of the prediction in units of that of a sample. Shape (n, n_joints).

        LMS has no covariance of its weights; a diagonal one, from how much each weight has been used, takes
        its place (ours).
        """
        scaled = self.context.input_range.scale(inputs)
        columns = []
        for tree, seen in zip(self._trees, self._seen, strict=True):
            psi = tree.features(scaled)
            columns.append(np.einsum("ij,ij,j->i", psi, psi, 1.0 / (1.0 + seen.ravel())))
        return np.column_stack(columns)

    def _learn(
        self, before: Self, samples: TrainingSamples, inputs: FloatArray, targets_rad: FloatArray
    ) -> list[str]:
        """Learn the samples in random order.

        Neighbours in time are so alike that in their own order each part of the movement overwrites what the
        others taught (error of the second trial of the paper's schedule 0.116 instead of 0.005 rad).
        """
        self._trees, self._seen = copy.deepcopy((self._trees, self._seen))
        learning = self.context.learning
        rng = np.random.default_rng([self.context.seed, before.trials_learned])
        scaled = self.context.input_range.scale(inputs)
        orders = [rng.permutation(len(scaled)) for _ in range(learning.passes)]
        grown: list[str] = []
        for j, (joint, tree) in enumerate(zip(self.context.joints, self._trees, strict=True)):
            variance = np.zeros_like(tree.weights)
            for order in orders:
                variance += tree.learn(scaled, targets_rad[:, j], learning.rate, order)
            if not np.all(np.isfinite(tree.weights)):
                raise TrainingError(f"the weights of {joint} did not stay finite; the network is unchanged")
            grown += self._grow(j, tree, variance)
            self._seen[j] += np.sum(tree.features(scaled) ** 2, axis=0).reshape(tree.weights.shape)
        self._calibrate(before, samples.actual, samples.offset_rad)
        return grown

    def _grow(self, joint: int, tree: LmsTree, change_variance: FloatArray) -> list[str]:
        grown, learning = [], self.context.learning
        empty = np.zeros((1, *change_variance.shape[1:]))
        for _ in range(min(learning.growth_per_trial, learning.max_subtrees - tree.n_subtrees)):
            leaf = tree.most_pulled_leaf(change_variance)
            tree.grow(leaf)
            change_variance = np.concatenate([change_variance, empty])
            self._seen[joint] = np.concatenate([self._seen[joint], empty])
            grown.append(growth_text(self.context.joints, joint, tree.n_subtrees, leaf))
        return grown
