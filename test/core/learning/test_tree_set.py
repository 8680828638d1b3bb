"""Trees as arrays, and what is said of them."""

from __future__ import annotations

import numpy as np
import pytest
from two_link_trials import context

from tel_ros.core.learning.lms_tree import (
    Leaf,
    LmsTree,
    growth_text,
    new_trees,
    restore_trees,
    tree_arrays,
)

X = np.random.default_rng(1).random((40, 6))


def grown_trees() -> list[LmsTree]:
    trees = new_trees(context(gaussians_per_input=5))
    for leaf in (Leaf(0, 1, 2), Leaf(1, 5, 4)):
        trees[1].grow(leaf)
    rng = np.random.default_rng(0)
    for tree in trees:
        tree.weights = rng.normal(size=tree.weights.shape)
    return trees


def test_there_is_one_root_a_joint_of_the_configured_size() -> None:
    trees = new_trees(context(gaussians_per_input=7, gaussian_width=0.6))
    assert [tree.weights.shape for tree in trees] == [(1, 6, 7)] * 2
    assert [tree.width for tree in trees] == [0.6, 0.6]


@pytest.mark.parametrize(
    ("gaussians", "weights", "normalised"),
    [
        ("auto", "lms", False),
        ("auto", "least_squares", True),
        ("raw", "least_squares", False),
        ("normalised", "lms", True),
    ],
)
def test_gaussians_are_normalised_where_it_is_asked_for_or_where_weights_are_solved_for(
    gaussians: str, weights: str, normalised: bool
) -> None:
    for tree in new_trees(context(gaussians=gaussians, weights=weights)):
        assert tree.normalised == normalised


def test_trees_come_back_from_their_arrays_bit_by_bit() -> None:
    trees = grown_trees()
    back = restore_trees(context(gaussians_per_input=5), tree_arrays(trees))
    for tree, same in zip(trees, back, strict=True):
        assert same.parents.tolist() == tree.parents.tolist()
        np.testing.assert_array_equal(same.predict(X), tree.predict(X))


@pytest.mark.parametrize(
    ("name", "array", "said"),
    [
        ("weights_0", np.zeros((2, 6, 5)), r"weights_0 has shape \(2, 6, 5\), not \(1, 6, 5\)"),
        ("weights_1", np.zeros((3, 6, 4)), r"weights_1 has shape \(3, 6, 4\), not \(3, 6, 5\)"),
        ("parents_1", np.array([[0, 1, 2], [2, 0, 0]]), r"subtree=2.* no leaf of an earlier subtree"),
        ("parents_1", np.array([[0, 1, 2], [0, 6, 0]]), r"input=6.* no leaf of an earlier subtree"),
        ("parents_1", np.array([[0, 1, 2], [0, 0, -1]]), r"gaussian=-1.* no leaf of an earlier subtree"),
    ],
)
def test_arrays_that_do_not_fit_together_are_refused_with_what_is_wrong(
    name: str, array: np.ndarray, said: str
) -> None:
    with pytest.raises(ValueError, match=said):
        restore_trees(context(gaussians_per_input=5), {**tree_arrays(grown_trees()), name: array})


def test_the_pull_on_each_weight_is_that_of_lms_at_weights_that_stay_as_they_are() -> None:
    tree, y = grown_trees()[1], np.sin(7.0 * X[:, 0])
    changes = []
    for x, target in zip(X, y, strict=True):
        before = tree.weights
        tree.learn(x[None], np.array([target]), 1.0)
        changes.append(tree.weights - before)
        tree.weights = before
    pulled = tree.change_variance(X, y - tree.predict(X))
    # One formula subtracts two means, the other squares differences: rounding of changes of order 0.1.
    np.testing.assert_allclose(pulled, np.var(changes, axis=0), atol=1e-12)


def test_the_text_names_the_joint_the_input_and_the_place_in_the_tree() -> None:
    joints = ("shoulder", "elbow")
    assert growth_text(joints, 1, 3, Leaf(0, 4, 0)) == (
        "elbow: subtree 3 under Gaussian 1 of shoulder acceleration in the root"
    )
    assert growth_text(joints, 0, 1, Leaf(2, 3, 9)) == (
        "shoulder: subtree 1 under Gaussian 10 of elbow velocity in subtree 2"
    )
