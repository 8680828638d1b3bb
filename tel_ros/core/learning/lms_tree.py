"""The LMS tree: sums of products of one-dimensional Gaussians, grown where they are needed.

The paper names the network and its size ([Practice] Sec. 3: 10 Gaussians for each of 6 inputs, 15 subtrees a
joint) and leaves its definition to Sanger (1991a, 1991b). The form below is put together from what is public
about it; where it had to be chosen it is ours, and marked so.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tel_ros.core.learning import tree_kernels
from tel_ros.core.types import FloatArray, IntArray


@dataclass(frozen=True)
class Leaf:
    """One weight of the tree: a Gaussian of one input, in one subtree (0 is the root)."""

    subtree: int
    input: int
    gaussian: int


class LmsTree:
    """One output as a function of inputs in 0 … 1, linear in its weights.

    N(x) = Σ_k g_k(x) Σ_d,i w_k,d,i φ_d,i(x) with φ_d,i(x) = exp(-(x_d - c_i)² / 2σ²). The root has g_0 = 1; a
    subtree that hangs under leaf (k, d, i) has g = g_k φ_d,i, so that each way from the root is a product of
    one-dimensional Gaussians.

    Args:
        n_inputs: D.
        n_gaussians: G, evenly spaced centres c_i from 0 to 1 for each input.
        width: σ in units of the spacing (ours: 1 lets neighbours overlap by 0.61 of their peak).
        normalised: divide the Gaussians of each input by their sum, so that they add up to 1 everywhere.
    """

    def __init__(self, n_inputs: int, n_gaussians: int, width: float, *, normalised: bool = False) -> None:
        self.n_inputs, self.n_gaussians, self.width = n_inputs, n_gaussians, width
        self.normalised = normalised
        self.weights: FloatArray = np.zeros((1, n_inputs, n_gaussians))
        self.parents: list[Leaf] = []
        """The leaf that each subtree hangs under; subtree k is ``parents[k - 1]``."""
        self.parents_array: IntArray = np.empty((0, 3), dtype=np.int64)
        """The same as (subtree, input, gaussian). Shape (n_subtrees, 3)."""
        self._sigma = width / (n_gaussians - 1)

    @property
    def n_subtrees(self) -> int:
        """Subtrees grown so far, the root not counted."""
        return len(self.parents)

    def features(self, inputs: FloatArray) -> FloatArray:
        """Return ψ, all g_k φ_d,i: (n, (1 + n_subtrees) * D * G) for inputs of shape (n, D)."""
        return tree_kernels.features(
            np.ascontiguousarray(inputs), self.parents_array, self.n_gaussians, self._sigma, self.normalised
        )

    def predict(self, inputs: FloatArray) -> FloatArray:
        """Return N(x). Input shape (n, D) in 0 … 1, output shape (n,)."""
        return tree_kernels.predict(
            np.ascontiguousarray(inputs), self.parents_array, self.weights, self._sigma, self.normalised
        )

    def grow(self, leaf: Leaf) -> None:
        """Hang a new subtree with zero weights under a leaf; the output does not change."""
        self.parents.append(leaf)
        row = np.array([[leaf.subtree, leaf.input, leaf.gaussian]], dtype=np.int64)
        self.parents_array = np.concatenate([self.parents_array, row])
        self.weights = np.concatenate([self.weights, np.zeros((1, self.n_inputs, self.n_gaussians))])

    def most_pulled_leaf(self, change_variance: FloatArray) -> Leaf:
        """Return the leaf without a subtree whose weight changes varied most.

        A weight that keeps being pulled in different directions stands for something that depends on another
        input as well: there the tree has to grow.

        Args:
            change_variance: variance of each weight's changes over a trial. Shape of ``weights``.
        """
        variance = change_variance.copy()
        for leaf in self.parents:
            variance[leaf.subtree, leaf.input, leaf.gaussian] = -1.0
        k, d, i = np.unravel_index(int(np.argmax(variance)), variance.shape)
        return Leaf(int(k), int(d), int(i))

    def learn(
        self, inputs: FloatArray, target: FloatArray, rate: float, order: IntArray | None = None
    ) -> FloatArray:
        """Go once through samples with the normalised LMS rule Δw = γ e ψ / (ε + |ψ|²), e = target - N(x).

        Args:
            inputs: shape (n, D) in 0 … 1.
            target: shape (n,).
            rate: γ, 0 < γ <= 1.
            order: rows in the order in which to learn; None: as they come.

        Returns:
            Variance of each weight's changes over the samples. Shape of ``weights``.
        """
        weights = self.weights.copy()
        variance = tree_kernels.lms_pass(
            np.ascontiguousarray(inputs),
            np.ascontiguousarray(target),
            np.arange(len(inputs)) if order is None else order,
            self.parents_array,
            weights,
            self._sigma,
            self.normalised,
            rate,
        )
        self.weights = weights
        return variance
