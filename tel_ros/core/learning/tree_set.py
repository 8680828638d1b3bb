"""What the learners made of trees have in common: making, storing and naming them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from tel_ros.core.learning.learner import LearnerContext
from tel_ros.core.learning.lms_tree import Leaf, LmsTree
from tel_ros.core.types import FloatArray


def new_trees(context: LearnerContext) -> list[LmsTree]:
    """Return one root a joint."""
    learning = context.learning
    normalised = learning.gaussians == "normalised" or (
        learning.gaussians == "auto" and learning.weights == "least_squares"
    )
    return [
        LmsTree(
            3 * len(context.joints),
            learning.gaussians_per_input,
            learning.gaussian_width,
            normalised=normalised,
        )
        for _ in context.joints
    ]


def tree_arrays(trees: Sequence[LmsTree]) -> dict[str, np.ndarray]:
    """Return trees as arrays: ``weights_j`` (1 + subtrees, D, G) and ``parents_j`` (subtrees, 3)."""
    arrays: dict[str, np.ndarray] = {}
    for j, tree in enumerate(trees):
        arrays[f"weights_{j}"], arrays[f"parents_{j}"] = tree.weights, tree.parents_array
    return arrays


def restore_trees(context: LearnerContext, arrays: Mapping[str, np.ndarray]) -> list[LmsTree]:
    """Return the trees in arrays.

    Raises:
        ValueError: they do not fit together.
    """
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
    kind, of = divmod(leaf.input, len(joints))
    name = f"{joints[of]} {('position', 'velocity', 'acceleration')[kind]}"
    home = f"subtree {leaf.subtree}" if leaf.subtree else "the root"
    return f"{joints[joint]}: subtree {subtree} under Gaussian {leaf.gaussian + 1} of {name} in {home}"


def change_variance(tree: LmsTree, inputs: FloatArray, residual: FloatArray) -> FloatArray:
    """Return how much LMS would pull each weight to and fro at weights that it did not find itself.

    Args:
        tree: whose weights they are.
        inputs: in 0 … 1. Shape (n, D).
        residual: target minus output. Shape (n,).

    Returns:
        Variance of Δw = e ψ / |ψ|². Shape of ``tree.weights``.
    """
    psi = tree.features(inputs)
    pull = residual / (1e-9 + np.einsum("ij,ij->i", psi, psi))
    mean = pull @ psi / len(pull)
    variance: FloatArray = pull**2 @ psi**2 / len(pull) - mean**2
    return variance.reshape(tree.weights.shape)
