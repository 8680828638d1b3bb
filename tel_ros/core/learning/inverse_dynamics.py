"""Learned inverse dynamics N: from the motion of an arm to the command that makes it."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from tel_ros.core.config import LearningConfig
from tel_ros.core.errors import TrainingError
from tel_ros.core.learning.inputs import InputRange
from tel_ros.core.learning.lms_tree import LmsTree
from tel_ros.core.learning.signals import TrainingSamples
from tel_ros.core.types import FloatArray

TrainingMode = Literal["actual", "desired"]


@dataclass(frozen=True)
class TrainingOutcome:
    """What training on one trial did.

    Args:
        rms_before_rad: RMS over all joints of û - N(ŷ) before training.
        rms_after_rad: the same after it.
        rms_command_change_rad: RMS change of the command for the trial's own desired trajectory.
        grown: what grew, in words.
    """

    rms_before_rad: float
    rms_after_rad: float
    rms_command_change_rad: float
    grown: tuple[str, ...]


def training_pair(
    mode: TrainingMode, samples: TrainingSamples, predict: Callable[[FloatArray], FloatArray]
) -> tuple[FloatArray, FloatArray]:
    """Return the inputs to train the network at, and what it should say there.

    Only the command û that was sent has a known outcome ŷ, so the error is always δ = û - N(ŷ). ``actual``
    removes it at ŷ, ``desired`` changes the output at y by the same δ ([Practice] Sec. 2.1 and Fig. 1;
    convergence by Theorems 2 and 1). δ is that of the network before training, as in Theorem 1.

    Args:
        mode: where to apply the error.
        samples: one trial.
        predict: N, from shape (n, 3 * n_joints) to offsets u - q of shape (n, n_joints).

    Returns:
        Inputs of shape (n, 3 * n_joints) and targets in rad of shape (n, n_joints).
    """
    if mode == "actual":
        return samples.actual, samples.offset_rad
    return samples.desired, predict(samples.desired) + samples.offset_rad - predict(samples.actual)


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


class LmsTreeInverseDynamics:
    """One LMS tree a joint, from (q, q̇, q̈) of all joints to the offset u - q of the equilibrium point.

    Untrained it gives 0: the equilibrium point is the desired position, which is right at low speed
    ([Practice] Sec. 2.2).

    Args:
        joints: names, in the order of all arrays.
        input_range: ranges of the 3 * n_joints inputs.
        learning: size of the trees and learning rate.
        seed: of the order in which samples are gone through.
    """

    def __init__(
        self, joints: tuple[str, ...], input_range: InputRange, learning: LearningConfig, seed: int
    ) -> None:
        self.joints, self.input_range, self.learning, self.seed = joints, input_range, learning, seed
        self.trials_learned = 0
        self.trees = [
            LmsTree(3 * len(joints), learning.gaussians_per_input, learning.gaussian_width) for _ in joints
        ]

    def predict(self, inputs: FloatArray) -> FloatArray:
        """Return u - q [rad] for inputs of shape (n, 3 * n_joints) in SI units. Shape (n, n_joints)."""
        scaled = self.input_range.scale(inputs)
        return np.column_stack([tree.predict(scaled) for tree in self.trees])

    @np.errstate(over="ignore", invalid="ignore")  # what does not stay finite is refused
    def trained_on(
        self, samples: TrainingSamples, mode: TrainingMode
    ) -> tuple[LmsTreeInverseDynamics, TrainingOutcome]:
        """Return a network that has learned from one trial, and what that did; this one stays as it is.

        The samples are gone through in random order: neighbours in time are so alike that in their own order
        each part of the movement overwrites what the others taught (error of the second trial of the paper's
        schedule 0.116 instead of 0.005 rad).

        Args:
            samples: the trial.
            mode: where to apply the command error (see :func:`training_pair`).

        Raises:
            TrainingError: the weights or the outcome did not stay finite.
        """
        network = copy.deepcopy(self)
        network.trials_learned += 1
        rng = np.random.default_rng([self.seed, self.trials_learned])
        inputs, targets = training_pair(mode, samples, self.predict)
        scaled = self.input_range.scale(inputs)
        orders = [rng.permutation(len(scaled)) for _ in range(self.learning.passes)]
        grown: list[str] = []
        for joint, tree, target in zip(self.joints, network.trees, targets.T, strict=True):
            variance = np.zeros_like(tree.weights)
            for order in orders:
                variance += tree.learn(scaled[order], target[order], self.learning.rate)
            if not np.all(np.isfinite(tree.weights)):
                raise TrainingError(f"the weights of {joint} did not stay finite; the network is unchanged")
            grown += network._grow(joint, tree, variance)
        before, after = self.predict(samples.desired), network.predict(samples.desired)
        rms_rad = (
            _rms(samples.offset_rad - self.predict(samples.actual)),
            _rms(samples.offset_rad - network.predict(samples.actual)),
            _rms(after - before),
        )
        if not all(map(math.isfinite, rms_rad)):
            raise TrainingError(f"the RMS errors {rms_rad} rad are not finite; the network is unchanged")
        return network, TrainingOutcome(*rms_rad, grown=tuple(grown))

    def _grow(self, joint: str, tree: LmsTree, change_variance: FloatArray) -> list[str]:
        grown = []
        for _ in range(min(self.learning.growth_per_trial, self.learning.max_subtrees - tree.n_subtrees)):
            leaf = tree.most_pulled_leaf(change_variance)
            tree.grow(leaf)
            change_variance = np.concatenate([change_variance, np.zeros((1, *change_variance.shape[1:]))])
            home = f"subtree {leaf.subtree}" if leaf.subtree else "the root"
            grown.append(
                f"{joint}: subtree {tree.n_subtrees} under Gaussian {leaf.gaussian + 1} of "
                f"{self._input_name(leaf.input)} in {home}"
            )
        return grown

    def _input_name(self, index: int) -> str:
        kind, joint = divmod(index, len(self.joints))
        return f"{self.joints[joint]} {('position', 'velocity', 'acceleration')[kind]}"
