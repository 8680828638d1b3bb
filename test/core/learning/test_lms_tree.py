"""The LMS tree: its function, its learning and growing, and trees as arrays."""

from __future__ import annotations

from math import exp

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

N_INPUTS, N_GAUSSIANS, WIDTH = 3, 5, 0.8
LEAVES = [Leaf(0, 1, 2), Leaf(1, 0, 3), Leaf(0, 2, 0), Leaf(2, 1, 4)]
"""The second hangs under the first and the last under the second: three Gaussians deep."""


def phi(x: np.ndarray, leaf: Leaf) -> float:
    spacing = 1.0 / (N_GAUSSIANS - 1)
    return exp(-((x[leaf.input] - leaf.gaussian * spacing) ** 2) / (2 * (WIDTH * spacing) ** 2))


def gate(x: np.ndarray, subtree: int) -> float:
    """Return g_k: the product of the Gaussians on the way from the root."""
    if subtree == 0:
        return 1.0
    parent = LEAVES[subtree - 1]
    return gate(x, parent.subtree) * phi(x, parent)


def output(x: np.ndarray, weights: np.ndarray) -> float:
    """Return N(x) = Σ_k g_k(x) Σ_d,i w_k,d,i φ_d,i(x)."""
    return sum(weights[k, d, i] * gate(x, k) * phi(x, Leaf(k, d, i)) for k, d, i in np.ndindex(weights.shape))


def grown_tree(seed: int | None = 0) -> LmsTree:
    """Return a tree with four subtrees, with random weights or (seed None) without any."""
    tree = LmsTree(N_INPUTS, N_GAUSSIANS, WIDTH)
    for leaf in LEAVES:
        tree.grow(leaf)
    if seed is not None:
        tree.weights = np.random.default_rng(seed).normal(size=tree.weights.shape)
    return tree


def inputs(n: int, seed: int = 1) -> np.ndarray:
    return np.random.default_rng(seed).random((n, N_INPUTS))


def test_an_untrained_tree_says_zero() -> None:
    np.testing.assert_array_equal(LmsTree(6, 10, 1.0).predict(np.random.default_rng(0).random((7, 6))), 0.0)


def test_the_output_of_a_grown_tree_is_the_sum_of_products_of_gaussians() -> None:
    tree, x = grown_tree(), inputs(20)
    expected = [output(row, tree.weights) for row in x]
    np.testing.assert_allclose(tree.predict(x), expected, rtol=1e-12, atol=1e-12)  # sums in another order


def test_each_feature_is_a_gaussian_behind_the_gate_of_its_subtree() -> None:
    tree, x = grown_tree(), inputs(4)
    psi = tree.features(x).reshape(4, 5, N_INPUTS, N_GAUSSIANS)
    for n, k, d, i in np.ndindex(psi.shape):
        assert psi[n, k, d, i] == pytest.approx(gate(x[n], k) * phi(x[n], Leaf(k, d, i)), rel=1e-12)


def test_a_gaussian_is_one_at_its_centre_and_centres_reach_from_end_to_end() -> None:
    tree = LmsTree(1, 10, 1.0)
    centres = np.linspace(0.0, 1.0, 10)[:, None]
    np.testing.assert_array_equal(np.diag(tree.features(centres)), 1.0)
    # One standard deviation away at the next centre.
    np.testing.assert_allclose(np.diag(tree.features(centres), 1), exp(-0.5), rtol=1e-12)


@pytest.mark.parametrize("leaf", [Leaf(0, 0, 0), Leaf(3, 2, 1)])
def test_growing_leaves_the_output_as_it_was(leaf: Leaf) -> None:
    tree, x = grown_tree(), inputs(20)
    before = tree.predict(x)
    tree.grow(leaf)
    np.testing.assert_allclose(tree.predict(x), before, rtol=1e-12)  # sums in another order
    assert tree.n_subtrees == 5


@pytest.mark.parametrize("rate", [0.1, 0.5, 1.0])
def test_learning_one_sample_removes_the_share_gamma_of_its_error(rate: float) -> None:
    tree, x, target = grown_tree(), inputs(1), np.array([3.0])
    error = target - tree.predict(x)
    tree.learn(x, target, rate)
    # The ε of the normalised rule is 1e-9 of |ψ|², which is above 1 here.
    np.testing.assert_allclose(target - tree.predict(x), (1.0 - rate) * error, atol=1e-8)


def test_the_change_of_a_weight_is_the_normalised_lms_rule() -> None:
    tree, x, target = grown_tree(), inputs(1), np.array([-2.0])
    psi, before = tree.features(x)[0], tree.weights.ravel().copy()
    error = -2.0 - psi @ before
    tree.learn(x, target, 0.3)
    np.testing.assert_allclose(tree.weights.ravel() - before, 0.3 * error * psi / (psi @ psi), atol=1e-8)


def test_samples_are_learned_one_after_the_other() -> None:
    together, apart, x = grown_tree(), grown_tree(), inputs(30)
    target = np.sin(5.0 * x.sum(axis=1))
    together.learn(x, target, 0.5)
    for k in range(30):
        apart.learn(x[k : k + 1], target[k : k + 1], 0.5)
    np.testing.assert_allclose(together.weights, apart.weights, atol=1e-12)  # sums in another order


def test_samples_are_learned_in_the_order_that_is_asked_for() -> None:
    ordered, shuffled, x = grown_tree(), grown_tree(), inputs(30)
    target, order = np.sin(5.0 * x.sum(axis=1)), np.random.default_rng(3).permutation(30)
    variance = ordered.learn(x, target, 0.5, order)
    np.testing.assert_array_equal(variance, shuffled.learn(x[order], target[order], 0.5))
    np.testing.assert_array_equal(ordered.weights, shuffled.weights)


def test_what_is_learned_leaves_weights_alone_that_somebody_has_kept() -> None:
    tree = grown_tree()
    kept = tree.weights
    before = kept.copy()
    tree.learn(inputs(10), np.ones(10), 0.5)
    np.testing.assert_array_equal(kept, before)
    assert not np.array_equal(tree.weights, before)


def test_the_memory_layout_of_the_inputs_does_not_matter() -> None:
    tree, x = grown_tree(), inputs(20)
    for laid_out in (np.asfortranarray(x), np.repeat(x, 2, axis=0)[::2]):
        np.testing.assert_array_equal(tree.predict(laid_out), tree.predict(x))
        np.testing.assert_array_equal(tree.features(laid_out), tree.features(x))


def test_normalised_gaussians_of_one_input_add_up_to_one_behind_their_gate() -> None:
    tree = LmsTree(N_INPUTS, N_GAUSSIANS, WIDTH, normalised=True)
    for leaf in LEAVES:
        tree.grow(leaf)
    x = inputs(4)
    psi = tree.features(x).reshape(4, 5, N_INPUTS, N_GAUSSIANS)

    def share(row: np.ndarray, leaf: Leaf) -> float:
        return phi(row, leaf) / sum(phi(row, Leaf(0, leaf.input, i)) for i in range(N_GAUSSIANS))

    for n, k in np.ndindex(4, 5):
        gate_k = 1.0
        subtree = k
        while subtree:
            leaf = LEAVES[subtree - 1]
            gate_k, subtree = gate_k * share(x[n], leaf), leaf.subtree
        np.testing.assert_allclose(psi[n, k].sum(axis=1), gate_k, rtol=1e-12)
        for d, i in np.ndindex(N_INPUTS, N_GAUSSIANS):
            assert psi[n, k, d, i] == pytest.approx(gate_k * share(x[n], Leaf(k, d, i)), rel=1e-12)


@pytest.mark.parametrize("normalised", [False, True])
def test_the_output_is_the_features_times_the_weights(normalised: bool) -> None:
    tree = LmsTree(N_INPUTS, N_GAUSSIANS, WIDTH, normalised=normalised)
    for leaf in LEAVES:
        tree.grow(leaf)
    tree.weights = np.random.default_rng(0).normal(size=tree.weights.shape)
    x = inputs(20)
    np.testing.assert_allclose(tree.predict(x), tree.features(x) @ tree.weights.ravel(), atol=1e-12)


def test_learning_again_and_again_approaches_a_function_that_the_tree_can_represent() -> None:
    truth, tree, x = grown_tree(seed=0), grown_tree(seed=None), inputs(100)
    target = truth.predict(x)
    before = np.sqrt(np.mean(target**2))
    for _ in range(50):
        tree.learn(x, target, 0.5)
    # The slowest of its directions are learned slowly: 0.04 is left, and less with each further pass.
    assert np.sqrt(np.mean((target - tree.predict(x)) ** 2)) < 0.1 * before


def test_the_variance_is_that_of_each_weights_changes() -> None:
    tree, x = grown_tree(), inputs(40)
    target = np.cos(7.0 * x[:, 0])
    one_by_one, weights = grown_tree(), [tree.weights.copy()]
    for k in range(40):
        one_by_one.learn(x[k : k + 1], target[k : k + 1], 0.5)
        weights.append(one_by_one.weights.copy())
    variance = tree.learn(x, target, 0.5)
    # One formula subtracts two sums, the other squares differences: rounding of changes of order 0.1.
    np.testing.assert_allclose(variance, np.var(np.diff(weights, axis=0), axis=0), atol=1e-12)


def test_the_tree_grows_where_the_changes_varied_most() -> None:
    tree = grown_tree()
    variance = np.random.default_rng(5).random(tree.weights.shape)
    variance[3, 1, 2] = 2.0
    assert tree.most_pulled_leaf(variance) == Leaf(3, 1, 2)


def test_a_leaf_that_has_a_subtree_does_not_get_another() -> None:
    tree = grown_tree()
    variance = np.random.default_rng(5).random(tree.weights.shape)
    for leaf in LEAVES:
        variance[leaf.subtree, leaf.input, leaf.gaussian] = 10.0
    variance[1, 2, 2] = 2.0
    kept = variance.copy()
    assert tree.most_pulled_leaf(variance) == Leaf(1, 2, 2)
    np.testing.assert_array_equal(variance, kept)


def test_where_nothing_changed_a_free_leaf_is_found_all_the_same() -> None:
    tree = LmsTree(1, 3, 1.0)
    grown = []
    for _ in range(3):
        grown.append(tree.most_pulled_leaf(np.zeros(tree.weights.shape)))
        tree.grow(grown[-1])
    assert len(set(grown)) == 3


def test_a_tree_with_subtrees_learns_a_product_that_the_root_alone_cannot() -> None:
    """That is what growing is for: the root is a sum of functions of one input each."""
    rng = np.random.default_rng(2)
    x = rng.random((400, 2))
    target = (x[:, 0] - 0.5) * (x[:, 1] - 0.5)
    root, grown = LmsTree(2, 6, 1.0), LmsTree(2, 6, 1.0)
    for gaussian in range(6):
        grown.grow(Leaf(0, 0, gaussian))
    for tree in (root, grown):
        for _ in range(30):
            tree.learn(x, target, 0.5)
    errors = [np.sqrt(np.mean((target - tree.predict(x)) ** 2)) for tree in (root, grown)]
    assert errors[0] > 0.9 * target.std()
    assert errors[1] < 0.3 * target.std()


def test_the_parents_as_an_array_are_the_leaves_in_order() -> None:
    np.testing.assert_array_equal(grown_tree().parents, [(0, 1, 2), (1, 0, 3), (0, 2, 0), (2, 1, 4)])
    assert LmsTree(2, 3, 1.0).parents.shape == (0, 3)


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
