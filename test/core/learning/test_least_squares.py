"""Weights that are solved for, against plain dense algebra; and what prior and noise do to them."""

from __future__ import annotations

import numpy as np
import pytest

from tel_ros.core.learning import least_squares
from tel_ros.core.learning.least_squares import TreeData, TreeRegression, second_difference_prior
from tel_ros.core.learning.lms_tree import Leaf, LmsTree

ACCELERATION = 4
"""Of the inputs of two joints, 0 to 5: the first acceleration."""
LEAVES = (Leaf(0, 4, 2), Leaf(1, 1, 0), Leaf(0, 5, 3))


def regression(n_gaussians: int = 5, strength: float = 0.1, leaves: tuple[Leaf, ...] = ()) -> TreeRegression:
    tree = LmsTree(6, n_gaussians, 1.0, normalised=True)
    for leaf in leaves:
        tree.grow(leaf)
    return TreeRegression(tree, strength)


def random_data(n: int, seed: int = 0, noise: float = 0.0) -> TreeData:
    """Return samples of uneven weight, with noise in velocities and accelerations."""
    rng = np.random.default_rng(seed)
    return TreeData(
        inputs=rng.random((n, 6)),
        noise=np.tile([0.0, 0.0, noise, noise, noise, 2.0 * noise], (n, 1)),
        weight=rng.uniform(0.2, 2.0, n),
    )


def plain(inputs: np.ndarray, noise: float = 0.0) -> TreeData:
    """Return samples of equal weight, with the noise of accelerations that a fit is told."""
    columns = np.zeros_like(inputs)
    columns[:, 4:] = noise
    return TreeData(inputs, columns, np.ones(len(inputs)))


def fit(data: TreeData, y: np.ndarray, **form: object) -> TreeRegression:
    fitted = regression(**form)
    fitted.gram = fitted.gram_of(data)
    fitted.solve(fitted.moment_of(data, y))
    return fitted


def along_acceleration(values: np.ndarray | list[float]) -> np.ndarray:
    """Return inputs that differ in one acceleration alone."""
    inputs = np.full((len(values), 6), 0.5)
    inputs[:, ACCELERATION] = values
    return inputs


@pytest.mark.parametrize("n", [300, 4500], ids=["one_portion", "three_portions"])
@pytest.mark.parametrize("strength", [0.01, 1.0])
def test_the_weights_solve_the_normal_equations_with_the_prior(n: int, strength: float) -> None:
    data, y = random_data(n), np.random.default_rng(1).normal(size=n)
    solved = fit(data, y, strength=strength, leaves=LEAVES)
    psi = solved.tree.features(data.inputs)
    prior = np.kron(np.eye(psi.shape[1] // 5), second_difference_prior(5))
    normal = psi.T @ (psi * data.weight[:, None]) + strength * prior
    expected = np.linalg.solve(normal, psi.T @ (data.weight * y))
    np.testing.assert_allclose(solved.tree.weights.ravel(), expected, rtol=1e-6, atol=1e-9)


def test_the_prior_punishes_second_differences_and_a_hundredth_of_that_the_size() -> None:
    prior = second_difference_prior(6)
    rng = np.random.default_rng(0)
    for weights in (np.linspace(-2.0, 1.0, 6), rng.normal(size=6)):
        bends = weights[2:] - 2.0 * weights[1:-1] + weights[:-2]
        assert weights @ prior @ weights == pytest.approx(bends @ bends + 0.01 * weights @ weights)


@pytest.mark.parametrize("n_gaussians", [2, 3])
def test_a_row_of_gaussians_too_short_to_bend_still_has_a_prior(n_gaussians: int) -> None:
    assert np.linalg.eigvalsh(second_difference_prior(n_gaussians)).min() > 0.0
    data, x = plain(np.random.default_rng(0).random((200, 6))), np.random.default_rng(0).random((200, 6))
    solved = fit(data, x[:, 0], n_gaussians=n_gaussians, strength=1e-6)
    np.testing.assert_allclose(solved.tree.predict(x), x[:, 0], atol=0.2)


LINE = 3.0
"""Torque for an acceleration from one end of its range to the other."""


def learned_line(strength: float) -> TreeRegression:
    """Learn a line through rest on the middle half of an acceleration's range."""
    inputs = np.random.default_rng(0).random((600, 6))
    inputs[:, ACCELERATION] = 0.25 + 0.5 * inputs[:, ACCELERATION]
    return fit(plain(inputs), LINE * (inputs[:, ACCELERATION] - 0.5), n_gaussians=10, strength=strength)


@pytest.mark.parametrize("strength", [1e-3, 1e-1])
def test_a_line_in_an_acceleration_goes_on_straight_beyond_the_data_and_falls_back_with_a_mere_ridge(
    strength: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Inertial torque is such a line; a faster movement asks for what lies beyond the data."""
    beyond = np.array([0.1, 0.15, 0.2, 0.8, 0.85, 0.9])
    truth = LINE * (beyond - 0.5)
    smooth = learned_line(strength).tree.predict(along_acceleration(beyond)) / truth
    monkeypatch.setattr(least_squares, "second_difference_prior", np.eye)
    ridge = learned_line(strength).tree.predict(along_acceleration(beyond)) / truth
    np.testing.assert_allclose(smooth, 1.0, atol=0.06)
    assert np.all(ridge < smooth - 0.01)
    assert np.all(ridge[[0, -1]] < 0.8)


@pytest.mark.parametrize("noise", [0.0, 0.03], ids=["exact", "noisy"])
def test_growing_gives_the_normal_equations_of_the_grown_tree(noise: float) -> None:
    data = random_data(700, noise=noise)
    grown = regression()
    grown.gram = grown.gram_of(data)
    for leaf in LEAVES:
        grown.grow(leaf, data)
    afresh = regression(leaves=LEAVES).gram_of(data)
    assert grown.tree.parents.tolist() == [list(leaf) for leaf in LEAVES]
    np.testing.assert_allclose(grown.gram, afresh, rtol=1e-12, atol=1e-12)  # sums in another order
    np.testing.assert_allclose(grown.gram, grown.gram.T, atol=1e-12)


def test_growing_alone_leaves_the_output_as_it_was() -> None:
    data, y = random_data(300), np.random.default_rng(1).normal(size=300)
    grown = fit(data, y)
    before = grown.tree.predict(data.inputs)
    grown.grow(LEAVES[0], data)
    np.testing.assert_allclose(grown.tree.predict(data.inputs), before, atol=1e-12)


def test_only_the_columns_that_are_asked_for_are_computed() -> None:
    data, form = random_data(200, noise=0.03), regression(leaves=LEAVES)
    np.testing.assert_allclose(form.gram_of(data, 60), form.gram_of(data)[:, 60:], rtol=1e-12, atol=1e-12)


def slope_with(told_noise: float, noise: float) -> float:
    """Return the slope that is learned for a line of slope 1 from accelerations with noise."""
    rng = np.random.default_rng(0)
    inputs = 0.2 + 0.6 * rng.random((6000, 6))
    y = inputs[:, ACCELERATION] - 0.5
    measured = inputs.copy()
    measured[:, 4:] += noise * rng.normal(size=(6000, 2))
    learned = fit(plain(measured, told_noise), y, n_gaussians=5)
    return float(np.polyfit(inputs[:, ACCELERATION], learned.tree.predict(inputs), 1)[0])


def test_noise_in_the_regressors_flattens_the_slope_unless_its_size_is_told() -> None:
    """Errors in variables: 0.06 beside a spread of 0.17 attenuates by 0.17² / (0.17² + 0.06²) = 0.89."""
    assert slope_with(told_noise=0.0, noise=0.06) < 0.95
    assert slope_with(told_noise=0.06, noise=0.06) == pytest.approx(1.0, abs=0.02)


def test_only_noise_of_accelerations_is_taken_away() -> None:
    data, form = random_data(200), regression()
    noise = np.zeros_like(data.noise)
    noise[:, :4] = 0.2
    exact, same = form.gram_of(data), form.gram_of(TreeData(data.inputs, noise, data.weight))
    np.testing.assert_array_equal(exact, same)


@pytest.mark.parametrize("told_noise", [0.3, 3.0])
def test_more_noise_than_there_is_signal_still_leaves_weights(told_noise: float) -> None:
    data = plain(np.random.default_rng(0).random((300, 6)), told_noise)
    y = np.random.default_rng(1).normal(size=300)
    learner = regression(strength=0.1)
    learner.gram = learner.gram_of(data)
    assert np.linalg.eigvalsh(learner.gram + 0.1 * np.kron(np.eye(6), second_difference_prior(5)))[0] < 0.0
    learner.solve(learner.moment_of(data, y))
    assert np.all(np.isfinite(learner.tree.weights))
    assert np.abs(learner.tree.predict(data.inputs)).max() < 10.0 * np.abs(y).max()
    leverage = learner.leverage(data.inputs)
    assert np.all(np.isfinite(leverage))
    assert np.all(leverage > 0.0)
    assert learner.strength == 0.1, "the prior of the next trial is another question"


def test_the_leverage_is_the_variance_of_the_output() -> None:
    data, y = random_data(300), np.random.default_rng(1).normal(size=300)
    solved = fit(data, y, leaves=LEAVES)
    x = random_data(20, seed=5).inputs
    psi = solved.tree.features(x)
    normal = solved.gram + 0.1 * np.kron(np.eye(psi.shape[1] // 5), second_difference_prior(5))
    expected = np.sum(psi * np.linalg.solve(normal, psi.T).T, axis=1)
    np.testing.assert_allclose(solved.leverage(x), expected, rtol=1e-6)


def test_the_leverage_grows_with_the_distance_from_the_data() -> None:
    leverage = learned_line(0.1).leverage(along_acceleration([0.5, 0.75, 0.85, 1.0]))
    assert np.all(np.diff(leverage) > 0.0)
    assert leverage[3] > 10.0 * leverage[0]


def test_leverage_can_be_asked_for_without_solving_again() -> None:
    data, y = random_data(300), np.random.default_rng(1).normal(size=300)
    solved, restored = fit(data, y), regression()
    restored.gram = restored.gram_of(data)
    np.testing.assert_allclose(restored.leverage(data.inputs), solved.leverage(data.inputs), rtol=1e-12)


def test_a_silent_tree_says_nothing_and_is_sure_of_it() -> None:
    data, y = random_data(300), np.random.default_rng(1).normal(size=300)
    quiet = fit(data, y)
    quiet.silent = True
    quiet.solve(quiet.moment_of(data, y))
    np.testing.assert_array_equal(quiet.tree.predict(data.inputs), 0.0)
    np.testing.assert_array_equal(quiet.leverage(data.inputs), 0.0)


def test_a_copy_can_grow_and_learn_without_changing_the_original() -> None:
    data, y = random_data(300), np.random.default_rng(1).normal(size=300)
    original = fit(data, y)
    answers, leverage = original.tree.predict(data.inputs), original.leverage(data.inputs)
    gram = original.gram.copy()
    twin = original.copy()
    np.testing.assert_array_equal(twin.tree.predict(data.inputs), answers)
    twin.grow(LEAVES[0], data)
    twin.gram *= 2.0
    twin.solve(twin.moment_of(data, -y))
    np.testing.assert_array_equal(original.tree.predict(data.inputs), answers)
    np.testing.assert_array_equal(original.leverage(data.inputs), leverage)
    np.testing.assert_array_equal(original.gram, gram)
    assert original.tree.n_subtrees == 0
