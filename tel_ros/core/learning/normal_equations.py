"""Least squares for a model that is linear in its parameters, with noise in its regressors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from tel_ros.core.types import FloatArray

_LEAST_EFFECT = 1e-12
"""Of a parameter in proportion to that of the strongest one."""
_RIDGE = 1e-3
"""Size of the ridge at strength 1, for each parameter, in units of the parameter's own effect."""


@dataclass(frozen=True)
class NormalEquations:
    """Sums over samples with regressors y and targets t.

    Args:
        gram: Σ yyᵀ, freed of what noise in the regressors has added. Shape (n, n).
        moment: Σ y t. Shape (n,).
        effect: Σ y² as it is, noise included. Shape (n,).
    """

    gram: FloatArray
    moment: FloatArray
    effect: FloatArray

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
        # More was taken away for noise than was there: a direction that only noise has shown. It is held at
        # zero as firmly as a parameter can be.
        values = np.where(values < -1e-9, 1.0, np.maximum(values, 0.0))
        regular = (vectors * (values + strength * _RIDGE * len(values))) @ vectors.T
        result: FloatArray = regular * np.outer(scale, scale)
        return result
