"""Least squares with a prior, for models that are linear in their parameters: rigid links and trees.

Linear algebra runs on one thread: the matrices are small, and where other processes want the cores, threads
of BLAS wait for each other by spinning (training of 17 short trials beside two busy processes: 9.4 s, on one
thread 0.7 s). And results do not depend on the number of cores.
"""

from __future__ import annotations

import copy
import functools
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import ParamSpec, Self, TypeVar

import numpy as np
from scipy.linalg import LinAlgError, cholesky, solve_triangular  # loads its BLAS, before it is looked for

from tel_ros.core.learning.lms_tree import Leaf, LmsTree
from tel_ros.core.types import FloatArray

try:
    from threadpoolctl import ThreadpoolController
except ImportError:  # rosdep has no key for it: without, training is slower on busy machines, and right
    ThreadpoolController = None

_LEAST_EFFECT = 1e-12
"""Of a parameter in proportion to that of the strongest one."""
_RIDGE = 1e-3
"""Size of the ridge at strength 1, for each parameter, in units of the parameter's own effect."""
SIZE_TO_SMOOTHNESS = 1e-2
"""Weight of the punishment of size in proportion to that of roughness."""
_LEAST_NOISE = 1e-3
"""Input noise below this part of an input's range is not worth being compensated."""
_PORTION = 2000
"""Samples whose features are held in memory at a time."""
_STEP = 1e-2
"""For differences along an input, in parts of its range."""

P = ParamSpec("P")
R = TypeVar("R")
_POOLS = ThreadpoolController and ThreadpoolController()


def on_one_thread(function: Callable[P, R]) -> Callable[P, R]:
    """Return a function that does its linear algebra on one thread, if threadpoolctl is installed."""
    if _POOLS is None:
        return function

    @functools.wraps(function)
    def wrapped(*args: P.args, **kwargs: P.kwargs) -> R:
        with _POOLS.limit(limits=1, user_api="blas"):
            return function(*args, **kwargs)

    return wrapped


@dataclass(frozen=True)
class NormalEquations:
    """Sums over samples with regressors y and targets t, solved with a ridge.

    Shapes (n, n), (n,), (n,).
    """

    gram: FloatArray
    """Σ yyᵀ, freed of what noise in the regressors has added."""
    moment: FloatArray
    """Σ y t."""
    effect: FloatArray
    """Σ y² as it is, noise included."""

    @classmethod
    def empty(cls, n: int) -> Self:
        """Return those of no samples."""
        return cls(np.zeros((n, n)), np.zeros(n), np.zeros(n))

    def __add__(self, other: NormalEquations) -> NormalEquations:
        """Return those of both sets of samples."""
        return NormalEquations(self.gram + other.gram, self.moment + other.moment, self.effect + other.effect)

    def scaled(self, factor: float) -> NormalEquations:
        """Return those of the same samples with other weights."""
        return NormalEquations(factor * self.gram, factor * self.moment, factor * self.effect)

    def solution(self, strength: float) -> FloatArray:
        """Return the parameters. Shape (n,)."""
        return np.asarray(np.linalg.solve(self.regular(strength), self.moment), dtype=np.float64)

    def regular(self, strength: float) -> FloatArray:
        """Return the gram with a ridge, each parameter in units of its own effect. Shape (n, n)."""
        scale = np.sqrt(np.maximum(self.effect, max(_LEAST_EFFECT * self.effect.max(), 1e-300)))
        normal = self.gram / np.outer(scale, scale)
        values, vectors = np.linalg.eigh(0.5 * (normal + normal.T))
        # Where noise has added more than there was, only noise has shown that direction: it is held at zero
        # as firmly as a parameter can be.
        values = np.where(values < -1e-9, 1.0, np.maximum(values, 0.0))
        regular = (vectors * (values + strength * _RIDGE * len(values))) @ vectors.T
        return regular * np.outer(scale, scale)


@dataclass(frozen=True)
class TreeData:
    """Samples in the units of a tree: inputs in 0 … 1 and their noise (n, D), weights (n,)."""

    inputs: FloatArray
    noise: FloatArray
    weight: FloatArray

    def portions(self) -> Iterator[tuple[slice, TreeData]]:
        """Yield the samples a few at a time, with their rows."""
        for start in range(0, len(self.weight), _PORTION):
            rows = slice(start, start + _PORTION)
            yield rows, TreeData(self.inputs[rows], self.noise[rows], self.weight[rows])


def second_difference_prior(n_gaussians: int) -> FloatArray:
    """Return the prior precision of the weights of one row of Gaussians. Shape (G, G).

    It punishes the second difference of the weights (P-splines: Eilers and Marx, Statistical Science 11,
    1996), and, a hundred times weaker, the weights themselves. So a tree goes on in a straight line where
    there are no data: inertial torque is linear in acceleration, and a movement that is a little faster than
    any before is predicted from slower ones. Punished for their size alone, Gaussians fall to zero there.
    """
    if n_gaussians < 3:
        return np.eye(n_gaussians)
    difference = np.diff(np.eye(n_gaussians), 2, axis=0)
    return difference.T @ difference + SIZE_TO_SMOOTHNESS * np.eye(n_gaussians)


class TreeRegression:
    """A tree whose weights are solved for, in place, with a prior of a strength in samples."""

    def __init__(self, tree: LmsTree, strength: float) -> None:
        self.tree, self.strength = tree, strength
        self.silent = False
        """Whether the weights stay 0, because the base predicts better alone."""
        self.gram: FloatArray = np.zeros((tree.weights.size, tree.weights.size))
        """Σ w ψψᵀ, freed of what noise in the inputs adds. Shape (n_weights, n_weights)."""
        self._factor: FloatArray | None = None

    def copy(self) -> TreeRegression:
        """Return one that can be changed without changing this one."""
        twin = copy.copy(self)
        twin.tree, twin.gram = copy.deepcopy(self.tree), self.gram.copy()
        return twin

    def gram_of(self, data: TreeData, first: int = 0) -> FloatArray:
        """Return the columns from ``first`` on of Σ w ψψᵀ, freed of what noise in the inputs has added.

        Noise n in the regressors makes E[ψ(x + n) ψ(x + n)ᵀ] too large by (∂ψ/∂x) σ² (∂ψ/∂x)ᵀ, which pulls
        all weights towards zero (errors in variables). Its size is known from the filter, so it is
        subtracted. Only accelerations are noisy enough. Shape (n_weights, n_weights - first).
        """
        size, n_joints = self.tree.weights.size, self.tree.n_inputs // 3
        gram = np.zeros((size, size - first))
        for _, part in data.portions():
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
        for rows, part in data.portions():
            moment += (part.weight * y[rows]) @ self.tree.features(part.inputs)
        return moment

    def grow(self, leaf: Leaf, data: TreeData) -> None:
        """Hang a subtree under a leaf, and add the samples' normal equations of its weights."""
        before = self.tree.weights.size
        self.tree.grow(leaf)
        columns = self.gram_of(data, before)
        gram = np.empty((len(columns), len(columns)))
        gram[:before, :before] = self.gram
        gram[:, before:] = columns
        gram[before:, :before] = columns[:before].T
        self.set_gram(gram)

    def solve(self, moment: FloatArray) -> None:
        """Set the weights to the solution of (gram + prior) w = Σ w ψ y, the moment; to 0 if silent."""
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
        return np.einsum("ij,ij->j", half, half)

    def _factorised(self) -> FloatArray:
        """Return the Cholesky factor of the gram with the prior added."""
        block, n = second_difference_prior(self.tree.n_gaussians), self.tree.n_gaussians

        def factor_of(gram: FloatArray) -> FloatArray:
            regular = gram.copy()
            for start in range(0, len(regular), n):
                regular[start : start + n, start : start + n] += self.strength * block
            return cholesky(regular, lower=True, overwrite_a=True, check_finite=False)

        try:
            return factor_of(self.gram)
        except LinAlgError:
            # In some directions more was subtracted for noise than there was. Their sign is noise, too; their
            # size is not.
            values, vectors = np.linalg.eigh(self.gram)
            return factor_of((vectors * np.abs(values)) @ vectors.T)
