"""The weights of one tree by least squares: linear in them, so they can be solved for instead of approached.

The prior makes it more than a fit. Along each row of Gaussians it punishes the second difference of the
weights (P-splines: Eilers and Marx, Statistical Science 11, 1996), and, a hundred times weaker, the weights
themselves. So the tree goes on in a straight line where there are no data: inertial torque is linear in
acceleration, and a movement that is a little faster than any before is met by what is known from slower ones.
Gaussians that are punished for their size alone fall back to zero there.
"""

from __future__ import annotations

import copy
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.linalg import LinAlgError, cholesky, solve_triangular

from tel_ros.core.learning.lms_tree import Leaf, LmsTree
from tel_ros.core.types import FloatArray

SIZE_TO_SMOOTHNESS = 1e-2
"""Weight of the punishment of size in proportion to that of roughness."""
_LEAST_NOISE = 1e-3
"""Input noise below this part of an input's range is not worth being compensated."""
_PORTION = 2000
"""Samples whose features are held in memory at a time."""
_STEP = 1e-2
"""For differences along an input, in parts of its range."""


@dataclass(frozen=True)
class TreeData:
    """Samples in the units of a tree.

    Args:
        inputs: in 0 … 1. Shape (n, D).
        noise: standard deviation of the noise in each input, in parts of its range. Shape (n, D).
        weight: shape (n,).
    """

    inputs: FloatArray
    noise: FloatArray
    weight: FloatArray

    def __getitem__(self, rows: slice) -> TreeData:
        """Return some of the samples."""
        return TreeData(self.inputs[rows], self.noise[rows], self.weight[rows])


def second_difference_prior(n_gaussians: int) -> FloatArray:
    """Return the prior precision of the weights of one row of Gaussians. Shape (G, G)."""
    if n_gaussians < 3:
        return np.eye(n_gaussians)
    difference = np.diff(np.eye(n_gaussians), 2, axis=0)
    result: FloatArray = difference.T @ difference + SIZE_TO_SMOOTHNESS * np.eye(n_gaussians)
    return result


class TreeRegression:
    """A tree and the normal equations of its weights.

    Args:
        tree: whose weights to solve for; it is changed in place.
        strength: of the prior, in samples.
    """

    def __init__(self, tree: LmsTree, strength: float) -> None:
        self.tree, self.strength = tree, strength
        self.silent = False
        """Whether to say nothing, because what others say is better alone."""
        self.gram: FloatArray = np.zeros((tree.weights.size, tree.weights.size))
        """Σ w ψψᵀ, freed of what noise in the inputs adds. Shape (n_weights, n_weights)."""
        self._factor: FloatArray | None = None

    def copy(self) -> TreeRegression:
        """Return one that can be changed without changing this one."""
        twin = TreeRegression(copy.deepcopy(self.tree), self.strength)
        twin.gram, twin._factor, twin.silent = self.gram.copy(), self._factor, self.silent
        return twin

    def gram_of(self, data: TreeData, first: int = 0) -> FloatArray:
        """Return the columns from ``first`` on of Σ w ψψᵀ, freed of what noise in the inputs has added.

        Noise n in the regressors makes E[ψ(x + n) ψ(x + n)ᵀ] too large by (∂ψ/∂x) σ² (∂ψ/∂x)ᵀ, which pulls
        all weights towards zero (errors in variables). Its size is known from the filter, so it is taken
        away. Only accelerations have noise worth it.

        Returns:
            Shape (n_weights, n_weights - first).
        """
        size, n_joints = self.tree.weights.size, self.tree.n_inputs // 3
        gram = np.zeros((size, size - first))
        for part in _portions(data):
            root = np.sqrt(part.weight)[:, None]
            psi = self.tree.features(part.inputs) * root
            gram += psi.T @ psi[:, first:]
            for d in range(2 * n_joints, 3 * n_joints):
                if part.noise[:, d].max() < _LEAST_NOISE:
                    continue
                aside = np.zeros(self.tree.n_inputs)
                aside[d] = _STEP
                ahead, behind = (self.tree.features(part.inputs + sign * aside) for sign in (1.0, -1.0))
                slope = (ahead - behind) * (root * part.noise[:, [d]] / (2.0 * _STEP))
                gram -= slope.T @ slope[:, first:]
        return gram

    def moment_of(self, data: TreeData, y: FloatArray) -> FloatArray:
        """Return Σ w ψ y for targets y of shape (n,). Shape (n_weights,)."""
        moment = np.zeros(self.tree.weights.size)
        for part, wanted in zip(_portions(data), _portions_of(y), strict=True):
            moment += (part.weight * wanted) @ self.tree.features(part.inputs)
        return moment

    def grow(self, leaf: Leaf, data: TreeData) -> None:
        """Hang a subtree under a leaf, and add what the samples so far say about its weights."""
        before = self.tree.weights.size
        self.tree.grow(leaf)
        columns = self.gram_of(data, before)
        gram = np.empty((len(columns), len(columns)))
        gram[:before, :before] = self.gram
        gram[:, before:] = columns
        gram[before:, :before] = columns[:before].T
        self.gram, self._factor = gram, None

    def solve(self, moment: FloatArray) -> None:
        """Set the weights to the solution of (gram + prior) w = moment; to 0 if silent.

        Args:
            moment: Σ w ψ y. Shape (n_weights,).
        """
        if self.silent:
            self.tree.weights = np.zeros_like(self.tree.weights)
            return
        self._factor = self._factorised()
        half = solve_triangular(self._factor, moment, lower=True, check_finite=False)
        weights = solve_triangular(self._factor, half, lower=True, trans="T", check_finite=False)
        self.tree.weights = weights.reshape(self.tree.weights.shape)

    def set_gram(self, gram: FloatArray) -> None:
        """Take other normal equations. The weights stay as they are until they are solved for."""
        self.gram, self._factor = gram, None

    def leverage(self, inputs: FloatArray) -> FloatArray:
        """Return ψᵀ A⁻¹ ψ, the variance of the output in units of that of a sample. Shape (n,)."""
        if self.silent:
            return np.zeros(len(inputs))
        if self._factor is None:
            self._factor = self._factorised()
        psi = self.tree.features(inputs)
        half = solve_triangular(self._factor, psi.T, lower=True, check_finite=False)
        result: FloatArray = np.einsum("ij,ij->j", half, half)
        return result

    def _factorised(self) -> FloatArray:
        try:
            return self._factor_of(self.gram)
        except LinAlgError:
            # What was taken away for noise was more than what was there, in some directions. Their sign is
            # noise as well, their size is not.
            values, vectors = np.linalg.eigh(self.gram)
            return self._factor_of((vectors * np.abs(values)) @ vectors.T)

    def _factor_of(self, gram: FloatArray) -> FloatArray:
        """Return the Cholesky factor of a gram with the prior added."""
        block, n = second_difference_prior(self.tree.n_gaussians), self.tree.n_gaussians
        regular = gram.copy()
        for start in range(0, len(regular), n):
            regular[start : start + n, start : start + n] += self.strength * block
        factor: FloatArray = cholesky(regular, lower=True, overwrite_a=True, check_finite=False)
        return factor


def _portions(data: TreeData) -> Iterator[TreeData]:
    for start in range(0, len(data.weight), _PORTION):
        yield data[start : start + _PORTION]


def _portions_of(values: FloatArray) -> Iterator[FloatArray]:
    for start in range(0, len(values), _PORTION):
        yield values[start : start + _PORTION]
