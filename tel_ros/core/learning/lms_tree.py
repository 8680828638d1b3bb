"""The LMS tree: sums of products of one-dimensional Gaussians, grown where they are needed.

The paper names the network and its size ([Practice] Sec. 3: 10 Gaussians for each of 6 inputs, 15 subtrees a
joint) and leaves its definition to Sanger (1991a, 1991b). The form below is put together from what is public
about it; where it had to be chosen it is ours, and marked so.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import ModuleType
from typing import NamedTuple

import numpy as np

from tel_ros.core.learning.inputs import input_name
from tel_ros.core.learning.learner import LearnerContext
from tel_ros.core.types import FloatArray, IntArray


class Leaf(NamedTuple):
    """One weight of the tree: a Gaussian of one input, in one subtree (0 is the root)."""

    subtree: int
    input: int
    gaussian: int


class LmsTree:
    """One output as a function of inputs in 0 … 1, linear in its weights.

    N(x) = Σ_k g_k(x) Σ_d,i w_k,d,i φ_d,i(x) with φ_d,i(x) = exp(-(x_d - c_i)² / 2σ²). The root has g_0 = 1; a
    subtree that hangs under leaf (k, d, i) has g = g_k φ_d,i, so that each way from the root is a product of
    one-dimensional Gaussians.

    D inputs have G Gaussians each, with evenly spaced centres c_i from 0 to 1; ``width`` is σ in units of the
    spacing (ours: 1 lets neighbours overlap by 0.61 of their peak). ``normalised``: the Gaussians of each
    input are divided by their sum, so that they add up to 1 everywhere.
    """

    def __init__(self, n_inputs: int, n_gaussians: int, width: float, *, normalised: bool = False) -> None:
        self.n_inputs, self.n_gaussians, self.width = n_inputs, n_gaussians, width
        self.normalised = normalised
        self.weights: FloatArray = np.zeros((1, n_inputs, n_gaussians))
        self.parents: IntArray = np.empty((0, 3), dtype=np.int64)
        """The leaf that each subtree hangs under; subtree k has row k - 1. Shape (n_subtrees, 3)."""
        self._sigma = width / (n_gaussians - 1)

    @property
    def n_subtrees(self) -> int:
        """Subtrees grown so far, the root not counted."""
        return len(self.parents)

    @property
    def _kernels(self) -> ModuleType:
        from tel_ros.core.learning import tree_kernels  # late: compiled code takes long to load

        return tree_kernels

    def features(self, inputs: FloatArray) -> FloatArray:
        """Return ψ, all g_k φ_d,i: (n, (1 + n_subtrees) * D * G) for inputs of shape (n, D)."""
        form = (self.parents, self.n_gaussians, self._sigma, self.normalised)
        return self._kernels.features(np.ascontiguousarray(inputs), *form)

    def predict(self, inputs: FloatArray) -> FloatArray:
        """Return N(x). Input shape (n, D) in 0 … 1, output shape (n,)."""
        form = (self.parents, self.weights, self._sigma, self.normalised)
        return self._kernels.predict(np.ascontiguousarray(inputs), *form)

    def grow(self, leaf: Leaf) -> None:
        """Hang a new subtree with zero weights under a leaf; the output does not change."""
        self.parents = np.concatenate([self.parents, np.array([leaf], dtype=np.int64)])
        self.weights = np.concatenate([self.weights, np.zeros((1, self.n_inputs, self.n_gaussians))])

    def most_pulled_leaf(self, change_variance: FloatArray) -> Leaf:
        """Return the leaf without a subtree whose weight changes varied most; shape of ``weights``.

        A weight that keeps being pulled in different directions depends on another input as well: there the
        tree has to grow.
        """
        variance = change_variance.copy()
        variance[tuple(self.parents.T)] = -1.0
        k, d, i = np.unravel_index(int(np.argmax(variance)), variance.shape)
        return Leaf(int(k), int(d), int(i))

    def change_variance(self, inputs: FloatArray, residual: FloatArray) -> FloatArray:
        """Return how much LMS would pull each weight to and fro, had it found these weights itself.

        That is the variance of Δw = e ψ / |ψ|² with the residual e, target minus output, of shape (n,) at
        inputs of shape (n, D). Shape of ``weights``.
        """
        psi = self.features(inputs)
        pull = residual / (1e-9 + np.einsum("ij,ij->i", psi, psi))
        mean = pull @ psi / len(pull)
        variance: FloatArray = pull**2 @ psi**2 / len(pull) - mean**2
        return variance.reshape(self.weights.shape)

    def learn(
        self, inputs: FloatArray, target: FloatArray, rate: float, order: IntArray | None = None
    ) -> FloatArray:
        """Go once through samples with the normalised LMS rule Δw = γ e ψ / (ε + |ψ|²), e = target - N(x).

        Inputs of shape (n, D) in 0 … 1, targets (n,), rate γ up to 1; ``order``: of the rows, None: as they
        come. Returns the variance of each weight's changes over the samples, in the shape of ``weights``.
        """
        order = np.arange(len(inputs)) if order is None else order
        self.weights = self.weights.copy()
        form = (order, self.parents, self.weights, self._sigma, self.normalised, rate)
        return self._kernels.lms_pass(np.ascontiguousarray(inputs), np.ascontiguousarray(target), *form)


def new_trees(context: LearnerContext) -> list[LmsTree]:
    """Return one root a joint."""
    learning = context.learning
    normalised = learning.gaussians == "normalised" or (
        learning.gaussians == "auto" and learning.weights == "least_squares"
    )
    n_inputs, size = 3 * len(context.joints), (learning.gaussians_per_input, learning.gaussian_width)
    return [LmsTree(n_inputs, *size, normalised=normalised) for _ in context.joints]


def tree_arrays(trees: Sequence[LmsTree]) -> dict[str, np.ndarray]:
    """Return trees as arrays: ``weights_j`` (1 + subtrees, D, G) and ``parents_j`` (subtrees, 3)."""
    return {f"{name}_{j}": getattr(t, name) for j, t in enumerate(trees) for name in ("weights", "parents")}


def restore_trees(context: LearnerContext, arrays: Mapping[str, np.ndarray]) -> list[LmsTree]:
    """Return the trees in arrays; raise ValueError if they do not fit together."""
    trees = new_trees(context)
    for j, tree in enumerate(trees):
        for row in arrays[f"parents_{j}"]:
            leaf = Leaf(*(int(value) for value in row))
            if not (0 <= leaf.subtree <= tree.n_subtrees and 0 <= leaf.input < tree.n_inputs
                    and 0 <= leaf.gaussian < tree.n_gaussians):  # fmt: skip
                raise ValueError(f"a subtree hangs under {leaf}, which is no leaf of an earlier subtree")
            tree.grow(leaf)
        weights = arrays[f"weights_{j}"]
        if weights.shape != tree.weights.shape:
            raise ValueError(f"weights_{j} has shape {weights.shape}, not {tree.weights.shape}")
        tree.weights = np.ascontiguousarray(weights, dtype=np.float64)
    return trees


def growth_text(joints: Sequence[str], joint: int, subtree: int, leaf: Leaf) -> str:
    """Say what has grown where."""
    home = f"subtree {leaf.subtree}" if leaf.subtree else "the root"
    name = input_name(joints, leaf.input)
    return f"{joints[joint]}: subtree {subtree} under Gaussian {leaf.gaussian + 1} of {name} in {home}"
