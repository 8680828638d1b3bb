"""A Gaussian process over the energies of an arm whose kinematics are not known.

An arm of rigid links has the kinetic energy ½ q̇ᵀ M(q) q̇ and a potential U(q). In cos q and sin q of joints
that turn, and q of joints that slide, M is of degree 2 a joint and U of degree 1, and M_pk, p ≤ k, depends on
the joints that p carries alone. Such polynomials are the prior here; Lagrange's equation, which is linear in
them, makes torques of them (A. Dalla Libera and R. Carli, RA-L 5(1), 2020, for the polynomials;
G. Giacomuzzo, R. Carli, D. Romeres and A. Dalla Libera, T-RO 40, 2024, for the energies). Each joint has
viscous and Coulomb friction.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product
from typing import Self

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.linalg.lapack import dpstrf

from tel_ros.core.learning.rigid_body import COULOMB_SPEED_RAD_S
from tel_ros.core.types import BoolArray, FloatArray, IntArray

FIRST_SHAPE = 0.7
"""b of the correlation 1 + b cos(q - q') until samples have told."""
_SHAPE_STEP = 3.0
_SHAPES = (0.005, 1.0)
"""Least and largest."""
_SHAPING_ROUNDS = (3, 1)
"""At first and later; each tries one step either way, joint by joint."""
_TUNED_OUTPUTS = 600
"""From about so many the prior is tuned; from half as many of seven joints it fits those and no others."""
_ROUNDS = (25, 8)
"""Of tuning, at first and later."""
_WEIGHT_OF_BEFORE = 1.0
"""Of a variance, in outputs that would show it."""
_LEAST_NOISE = 1e-4
"""Of the outputs."""
_CANDIDATES = 1600
"""Outputs among which those are found by which the others are expressed."""
_MOST_FEATURES = 600
_RANK = 1e-9


@dataclass(frozen=True)
class Samples:
    """States as :meth:`EnergyKernel.states` returns them, outputs and their weights."""

    states: FloatArray
    outputs: FloatArray
    weight: FloatArray
    """Both of shape (n, n_joints)."""

    def about(self, n_outputs: int) -> Self:
        """Return at most so many outputs, evenly spaced."""
        rows = slice(None, None, max(1, -(-self.outputs.size // n_outputs)))
        return type(self)(*(np.ascontiguousarray(values[rows]) for values in vars(self).values()))


@dataclass(frozen=True)
class Prior:
    """Variances of what is not known. Shapes (n_joints,).

    ``inertia`` of M_jj; that of M_pk is the geometric mean of two. ``potential`` of each link's, which
    depends on all joints up to its own. ``noise`` of an output. ``shape`` is no variance, but b of the
    correlation 1 + b cos(q - q') of a joint: how much may depend on it, a priori.
    """

    inertia: FloatArray
    potential: FloatArray
    viscous: FloatArray
    coulomb: FloatArray
    noise: FloatArray
    shape: FloatArray


@dataclass(frozen=True)
class EnergyKernel:
    """Covariances of the outputs: torques in units of one value a joint. Shapes (n_joints,)."""

    order: IntArray
    """The arm's joints, those before those that they carry."""
    slides: BoolArray
    middle: FloatArray
    scale: FloatArray
    """Positions of joints that slide are counted from the middle of their range, in units of half of it."""
    unit: FloatArray

    def states(self, inputs: FloatArray) -> FloatArray:
        """Return q, q̇, q̈, the smoothed sign of q̇, cos q, sin q: (n, 6 * n_joints), joints in order."""
        q, v, a = (part[:, self.order] for part in np.split(inputs, 3, axis=1))
        q = (q - self.middle) / self.scale
        sign = np.tanh(v / COULOMB_SPEED_RAD_S)
        columns = q, v / self.scale, a / self.scale, sign, np.cos(q), np.sin(q)
        return np.ascontiguousarray(np.hstack(columns))

    def first_prior(self, samples: Samples) -> Prior:
        """Return a prior by which each cause alone could make the outputs."""
        _, v, a, *_ = np.split(samples.states, 6, axis=1)
        output, speed, acceleration = (np.sqrt(np.mean(x**2, axis=0)) + 1e-9 for x in (samples.outputs, v, a))
        torque = output * self.unit
        friction = 0.1 * torque**2
        inertia, viscous = (torque / acceleration) ** 2, friction / speed**2
        return Prior(
            inertia, torque**2, viscous, friction, (0.03 * output) ** 2, np.full(len(output), FIRST_SHAPE)
        )

    def covariance(
        self,
        prior: Prior,
        states: FloatArray,
        others: FloatArray,
        weights: FloatArray,
        *,
        apart: bool = False,
    ) -> FloatArray:
        """Return covariances of all outputs with a weighted sum of those in each of m other states.

        The weights have the shape (m, n_joints), the result (n_parts, n * n_joints, m).
        """
        # Late: compiling takes seconds, once, and most processes do without.
        from tel_ros.core.learning import polynomial_kernels

        root = np.sqrt(prior.inertia)
        variances = (np.outer(root, root), prior.potential, prior.viscous, prior.coulomb)
        found = polynomial_kernels.covariance(
            states, others, weights / self.unit, self.slides, prior.shape, *variances, apart
        )
        found /= np.tile(self.unit, len(states))[:, None]
        return found

    def among(self, prior: Prior, states: FloatArray, *, apart: bool = False) -> FloatArray:
        """Return covariances of all outputs of some states. Shape (n_parts, n * n_joints, n * n_joints)."""
        n, n_joints = len(states), len(self.unit)
        others, each = np.repeat(states, n_joints, axis=0), np.tile(np.eye(n_joints), (n, 1))
        return self.covariance(prior, states, others, each, apart=apart)

    def tuned(self, prior: Prior | None, samples: Samples) -> Prior:
        """Return the prior under which the outputs are most likely, from an earlier one or from nothing.

        Each variance is multiplied by the root of the ratio of what its part has made to what it was expected
        to (the MM algorithm for variance components: Zhou, Hu, Zhou and Lange, J. Comput. Graph. Stat. 28,
        2019), which needs no step size. None falls to 0: the variance before counts as an observation.
        """
        some, n, later = samples.about(_TUNED_OUTPUTS), len(self.unit), prior is not None
        prior = self._shaped(prior or self.first_prior(samples), some, _SHAPING_ROUNDS[later])
        parts, outputs = self.among(prior, some.states, apart=True), some.outputs.ravel()
        pairs = np.column_stack(np.triu_indices(n))
        involved = 0.5 * (pairs[:, :1] == np.arange(n)) + 0.5 * (pairs[:, 1:] == np.arange(n))
        scale, noise, weight = np.ones(4 * n), prior.noise, some.weight.ravel()
        joint = np.tile(np.arange(n), len(some.states))
        least = (_LEAST_NOISE * np.sqrt(np.mean(some.outputs**2, axis=0)) + 1e-12) ** 2
        for _ in range(_ROUNDS[later]):
            factor = np.concatenate([np.exp(involved @ np.log(scale[:n])), scale[n:]])
            total = np.tensordot(factor, parts, 1)
            total[np.diag_indices_from(total)] += noise[joint] / weight
            inverse = np.linalg.inv(total)
            z = inverse @ outputs
            made = factor * ((parts @ z) @ z)
            expected = factor * np.tensordot(parts, inverse, 2)
            made, expected = (
                np.concatenate([values[: len(pairs)] @ involved, values[len(pairs) :]])
                for values in (made, expected)
            )
            scale = scale * np.sqrt((made + _WEIGHT_OF_BEFORE / scale) / (expected + _WEIGHT_OF_BEFORE))
            left = np.bincount(joint, z**2 / weight) / np.bincount(joint, inverse.diagonal() / weight)
            noise = np.maximum(noise * np.sqrt(left), least)
        known = (prior.inertia, prior.potential, prior.viscous, prior.coulomb)
        inertia, potential, viscous, coulomb = map(np.multiply, known, np.split(scale, 4))
        return Prior(inertia, potential, viscous, coulomb, noise, prior.shape)

    def _shaped(self, prior: Prior, some: Samples, n_rounds: int) -> Prior:
        """Return a prior whose shapes make the outputs more likely.

        An inertia that depends on all joints as much as it can is what most arms do not have: of seven joints
        each new path would show something never seen.
        """
        best = self._log_likelihood(prior, some)
        for _ in range(n_rounds):
            before = prior
            for j, factor in product(range(len(self.unit)), (1.0 / _SHAPE_STEP, _SHAPE_STEP)):
                shape = prior.shape.copy()
                shape[j] = np.clip(factor * shape[j], *_SHAPES)
                tried = replace(prior, shape=shape)
                if shape[j] != prior.shape[j] and (likely := self._log_likelihood(tried, some)) > best:
                    best, prior = likely, tried
            if prior is before:
                break
        return prior

    def _log_likelihood(self, prior: Prior, some: Samples) -> float:
        """Return the logarithm of how likely outputs are, but for a constant; -inf where it has none."""
        total = self.among(prior, some.states)[0]
        total[np.diag_indices_from(total)] += np.tile(prior.noise, len(some.states)) / some.weight.ravel()
        if not np.all(np.isfinite(total)):
            return -np.inf
        try:
            factor = cholesky(total, lower=True)
        except np.linalg.LinAlgError:
            return -np.inf
        half = solve_triangular(factor, some.outputs.ravel(), lower=True)
        return float(-0.5 * half @ half - np.sum(np.log(factor.diagonal())))


class Features:
    """Features of outputs, φ = L⁻¹ k(some outputs, ·), where LLᵀ is the covariance of those.

    A pivoted Cholesky decomposition chooses them: of two joints it finds all that there are, of seven the
    strongest.
    """

    def __init__(self, kernel: EnergyKernel, prior: Prior, samples: Samples) -> None:
        self.kernel, self.prior, n = kernel, prior, len(kernel.unit)
        some = samples.about(_CANDIDATES).states
        noise = np.sqrt(np.tile(prior.noise, len(some)))
        among = kernel.among(prior, some)[0] / np.outer(noise, noise)
        factor, pivots, rank, _ = dpstrf(among, tol=_RANK * among.diagonal().max(), lower=1)
        rank = min(rank, _MOST_FEATURES)
        state, joint = np.divmod(pivots[:rank].astype(np.int64) - 1, n)
        self.states, self.each = np.ascontiguousarray(some[state]), np.eye(n)[joint]
        self.factor = np.tril(factor[:rank, :rank]) * np.sqrt(prior.noise)[joint, None]

    def __call__(self, states: FloatArray) -> FloatArray:
        """Return φ of all outputs of some states. Shape (n * n_joints, n_features)."""
        found = self.kernel.covariance(self.prior, states, self.states, self.each)[0]
        return solve_triangular(self.factor, found.T, lower=True).T


class Posterior:
    """What samples have told about the outputs; ``rows`` are the features of theirs."""

    def __init__(self, features: Features, rows: FloatArray, samples: Samples) -> None:
        self._features = features
        root = np.sqrt(samples.weight / features.prior.noise).ravel()
        rows = rows * root[:, None]
        self._gram = cholesky(np.eye(rows.shape[1]) + rows.T @ rows, lower=True)
        half = solve_triangular(self._gram, (root * samples.outputs.ravel()) @ rows, lower=True)
        solved = solve_triangular(self._gram, half, lower=True, trans="T")
        weights = features.each * solve_triangular(features.factor, solved, lower=True, trans="T")[:, None]
        # One sum for all outputs of a state.
        self._states, state = np.unique(features.states, axis=0, return_inverse=True)
        self._weights = np.zeros((len(self._states), weights.shape[1]))
        np.add.at(self._weights, state, weights)

    @property
    def coulomb(self) -> FloatArray:
        """Coulomb friction of each joint, in units of the output. Shape (n_joints,)."""
        n = len(self._features.kernel.unit)
        signs = np.sum(self._states[:, 3 * n : 4 * n] * self._weights, axis=0)
        return self._features.prior.coulomb * signs / self._features.kernel.unit**2

    def mean(self, states: FloatArray) -> FloatArray:
        """Return the outputs that are most likely. Shape (n, n_joints)."""
        kernel, prior = self._features.kernel, self._features.prior
        found = kernel.covariance(prior, states, self._states, self._weights)[0]
        return found.sum(axis=1).reshape(len(states), -1)

    def variance(self, states: FloatArray) -> FloatArray:
        """Return the variance of the outputs, without noise. Shape (n, n_joints)."""
        kernel, prior = self._features.kernel, self._features.prior
        features = self._features(states)
        known = solve_triangular(self._gram, features.T, lower=True)
        total = [kernel.among(prior, state[None])[0].diagonal() for state in states]
        left = np.concatenate(total or [np.empty(0)]) - np.sum(features**2, axis=1)
        return (np.maximum(left, 0.0) + np.sum(known**2, axis=0)).reshape(len(states), -1)
