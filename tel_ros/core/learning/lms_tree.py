"""The LMS tree: sums of products of one-dimensional Gaussians, grown where they are needed.

The paper names the network and its size ([Practice] Sec. 3: 10 Gaussians for each of 6 inputs, 15 subtrees a
joint) and leaves its definition to Sanger (1991a, 1991b). The form below is put together from what is public
about it; where it had to be chosen it is ours, and marked so.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tel_ros.core.types import FloatArray, IntArray

_TINY = 1e-9


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
        n_gaussians: n, evenly spaced centres c_i from 0 to 1 for each input.
        width: σ in units of the spacing (ours: 1 lets neighbours overlap by 0.61 of their peak).
    """

    def __init__(self, n_inputs: int, n_gaussians: int, width: float) -> None:
        self.n_inputs, self.n_gaussians, self.width = n_inputs, n_gaussians, width
        self.weights: FloatArray = np.zeros((1, n_inputs, n_gaussians))
        self.parents: list[Leaf] = []
        """The leaf that each subtree hangs under; subtree k is ``parents[k - 1]``."""
        self._centres = np.linspace(0.0, 1.0, n_gaussians)
        self._sigma = width / (n_gaussians - 1)

    @property
    def n_subtrees(self) -> int:
        """Subtrees grown so far, the root not counted."""
        return len(self.parents)

    def features(self, inputs: FloatArray) -> FloatArray:
        """Return ψ, all g_k φ_d,i: (n, (1 + n_subtrees) * D * n_gaussians) for inputs of shape (n, D)."""
        distance = (inputs[:, :, None] - self._centres) / self._sigma
        phi = np.exp(-0.5 * distance * distance)
        gates = np.ones((1 + self.n_subtrees, len(inputs)))
        for k, leaf in enumerate(self.parents, start=1):
            gates[k] = gates[leaf.subtree] * phi[:, leaf.input, leaf.gaussian]
        psi = gates.T[:, :, None, None] * phi[:, None, :, :]
        return psi.reshape(len(inputs), -1)

    def predict(self, inputs: FloatArray) -> FloatArray:
        """Return N(x). Input shape (n, D) in 0 … 1, output shape (n,)."""
        return self.features(inputs) @ self.weights.ravel()

    def grow(self, leaf: Leaf) -> None:
        """Hang a new subtree with zero weights under a leaf; the output does not change."""
        self.parents.append(leaf)
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

    def learn(self, inputs: FloatArray, target: FloatArray, rate: float) -> FloatArray:
        """Go once through samples with the normalised LMS rule Δw = γ e ψ / (ε + |ψ|²), e = target - N(x).

        Args:
            inputs: in the order in which to learn. Shape (n, D) in 0 … 1.
            target: shape (n,).
            rate: γ, 0 < γ <= 1.

        Returns:
            Variance of each weight's changes over the samples. Shape of ``weights``.
        """
        psi = self.features(inputs)
        gain = rate / (_TINY + np.einsum("ij,ij->i", psi, psi))
        weights = self.weights.ravel().copy()
        total, squares = np.zeros_like(weights), np.zeros_like(weights)
        for psi_k, gain_k, target_k in zip(psi, gain, target, strict=True):
            change = (gain_k * (target_k - psi_k @ weights)) * psi_k
            weights += change
            total += change
            squares += change * change
        self.weights = weights.reshape(self.weights.shape)
        n = max(len(target), 1)
        variance: FloatArray = squares / n - (total / n) ** 2
        return variance.reshape(self.weights.shape)

    @property
    def parents_array(self) -> IntArray:
        """The parents as (subtree, input, gaussian). Shape (n_subtrees, 3)."""
        return np.array([(p.subtree, p.input, p.gaussian) for p in self.parents], dtype=np.int64).reshape(
            -1, 3
        )
