"""Trees solved for over all trials: when they grow, what they forget, and what they notice."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest
from two_link import TwoLinkArm
from two_link_trials import context, trial

from tel_ros.core.learning.inputs import InputRange
from tel_ros.core.learning.learner import Learner, rms
from tel_ros.core.learning.least_squares_learner import LeastSquaresLearner
from tel_ros.core.learning.lms_learner import LmsLearner
from tel_ros.core.learning.registry import OURS
from tel_ros.core.learning.signals import TrainingSamples

NOISE_RAD = 1e-3
DURATIONS_S = tuple(np.linspace(11.5, 4.5, 6))
CHANGED = "the arm has changed"
WITHIN_ONE = InputRange(np.full(6, -1.0), np.full(6, 1.0))


def untrained(**options: object) -> LeastSquaresLearner:
    options = {"weights": "least_squares", "gaussians_per_input": 6} | options
    return LeastSquaresLearner(context(**options))


def noisy(samples: TrainingSamples, seed: int, noise_rad: float = NOISE_RAD) -> TrainingSamples:
    noise = noise_rad * np.random.default_rng(seed).normal(size=samples.offset_rad.shape)
    return dataclasses.replace(samples, offset_rad=samples.offset_rad + noise)


def held_out_error(learner: Learner, arm: TwoLinkArm | None = None, duration_s: float = 5.0) -> float:
    samples = trial(duration_s, first=5, arm=arm)
    return rms(samples.offset_rad - learner.predict(samples.actual))


def practised(learner: Learner, noise_rad: float = NOISE_RAD) -> Learner:
    for seed, duration_s in enumerate(DURATIONS_S):
        learner, _ = learner.trained_on(noisy(trial(duration_s), seed, noise_rad), "actual")
    return learner


def test_the_same_trials_teach_it_far_more_than_sample_by_sample() -> None:
    solved = practised(untrained(gaussians_per_input=10))
    approached = practised(LmsLearner(context()))
    for duration_s in (11.0, 8.0, 4.5):
        ours, theirs = (held_out_error(one, duration_s=duration_s) for one in (solved, approached))
        assert ours < 0.2 * theirs


def test_a_trial_faster_than_any_before_is_met_by_what_slower_ones_taught() -> None:
    """Trajectory extension lives on this: each trial asks for a little more than the ones before."""
    learner = untrained(gaussians_per_input=10)
    for seed, duration_s in enumerate((11.5, 10.0, 8.7, 7.5)):
        learner, _ = learner.trained_on(noisy(trial(duration_s), seed), "actual")
    faster = trial(6.5)
    error = rms(faster.offset_rad - learner.predict(faster.actual))
    assert error < 0.1 * rms(faster.offset_rad)


def test_earlier_movements_are_not_unlearned_by_later_ones() -> None:
    learner = untrained(gaussians_per_input=10)
    for seed, duration_s in enumerate((11.5, 4.5, 4.5, 4.5)):
        learner, _ = learner.trained_on(noisy(trial(duration_s), seed), "actual")
    slow = trial(11.5)
    assert held_out_error(learner, duration_s=11.5) < 0.03 * rms(slow.offset_rad)


def samples_of(
    function: Callable[[np.ndarray], np.ndarray], seed: int, noise_rad: float, n: int = 400
) -> TrainingSamples:
    """Return a function of inputs from -1 to 1 as a trial of both joints."""
    rng = np.random.default_rng(seed)
    x = rng.uniform(-1.0, 1.0, (n, 6))
    y = np.column_stack([function(x)] * 2)
    return TrainingSamples(x, x, y + noise_rad * rng.normal(size=y.shape))


def additive(x: np.ndarray) -> np.ndarray:
    """Return what roots represent by themselves."""
    return 0.2 * np.sin(2.0 * x[:, 0]) + 0.1 * x[:, 2] ** 2 - 0.3 * x[:, 4]


def product(x: np.ndarray) -> np.ndarray:
    """Return what only subtrees can: an inertia that depends on the posture."""
    return 0.3 * x[:, 0] * x[:, 4] + 0.1 * x[:, 1]


def grown_on(
    function: Callable[[np.ndarray], np.ndarray], n_trials: int, noise_rad: float = 1e-2, **options: object
) -> tuple[LeastSquaresLearner, list[int]]:
    """Return what has learned a function, and how many subtrees it had altogether after each trial."""
    learner = untrained(input_range=WITHIN_ONE, growth_per_trial=5, **options)
    sizes = []
    for seed in range(n_trials):
        before = learner.subtrees
        learner, outcome = learner.trained_on(samples_of(function, seed, noise_rad), "actual")
        sizes.append(sum(learner.subtrees))
        assert len(outcome.grown) == sum(learner.subtrees) - sum(before)
    return learner, sizes


def test_where_subtrees_do_not_help_none_are_grown() -> None:
    learner, _ = grown_on(additive, 4)
    assert learner.subtrees == (0, 0)


def test_for_a_product_of_inputs_subtrees_are_grown_until_held_out_samples_are_not_helped_any_more() -> None:
    learner, sizes = grown_on(product, 8, max_subtrees=30)
    assert min(learner.subtrees) >= 3
    assert sum(learner.subtrees) < 30
    assert sizes[-1] - sizes[-3] <= 2
    exact = samples_of(product, 99, 0.0)
    root, _ = grown_on(product, 8, max_subtrees=0)
    ours, alone = (rms(exact.offset_rad - one.predict(exact.actual)) for one in (learner, root))
    assert ours < 0.1 * alone


def test_what_grew_is_said_for_the_joint_that_grew() -> None:
    learner = untrained(input_range=WITHIN_ONE)
    samples = samples_of(product, 1, 1e-2)
    samples.offset_rad[:, 0] += 0.1 * samples.actual[:, 2] - product(samples.actual)
    learner, outcome = learner.trained_on(samples, "actual")
    assert learner.subtrees == (0, 1)
    (text,) = outcome.grown
    assert text.startswith("elbow: subtree 1 under Gaussian ")
    assert "shoulder position in the root" in text or "shoulder acceleration in the root" in text


@pytest.mark.parametrize("limit", [0, 3, 8])
def test_trees_grow_up_to_the_limit_and_not_beyond(limit: int) -> None:
    def products(x: np.ndarray) -> np.ndarray:
        return sum(np.sin(2.0 * x[:, i] * x[:, j] + i) for i in range(3) for j in range(3, 6)) / 9.0

    learner = untrained(input_range=WITHIN_ONE, growth_per_trial=10, max_subtrees=limit)
    for seed in range(3):
        learner, _ = learner.trained_on(samples_of(products, seed, 1e-4, n=1500), "actual")
    assert learner.subtrees == (limit, limit)


def test_growth_of_one_trial_is_limited() -> None:
    learner = untrained(input_range=WITHIN_ONE, growth_per_trial=2)
    learner, _ = learner.trained_on(samples_of(product, 0, 1e-3), "actual")
    assert max(learner.subtrees) == 2


def test_forgetting_lets_a_change_be_followed_that_is_not_looked_for() -> None:
    heavier, errors = TwoLinkArm(inertia_scale=2.0), []
    for forgetting in (1.0, 0.3):
        learner = untrained(forgetting=forgetting, detect_change=False)
        for seed in range(3):
            learner, _ = learner.trained_on(noisy(trial(5.0), seed), "actual")
        for seed in range(2):
            learner, _ = learner.trained_on(noisy(trial(5.0, arm=heavier), seed), "actual")
        errors.append(held_out_error(learner, heavier))
    assert errors[1] < 0.4 * errors[0]


def test_what_is_forgotten_still_counts_while_nothing_changes() -> None:
    learner = practised(untrained(forgetting=0.8))
    assert held_out_error(learner) < 5.0 * NOISE_RAD


KINDS = {
    "least_squares": "lms_tree",
    "rigid_body": "rigid_body",
    "rigid_body+lms_tree": "rigid_body+lms_tree",
}


@pytest.fixture(params=list(KINDS.values()), ids=list(KINDS))
def solved(request: pytest.FixtureRequest) -> Callable[..., Learner]:
    """Return learners whose parameters are solved for: they look for changes of the arm in the same way."""
    if request.param != "lms_tree":
        pytest.importorskip("pinocchio")

    def make(**options: object) -> Learner:
        return OURS[request.param].new(context(weights="least_squares", gaussians_per_input=6, **options))

    return make


@pytest.mark.parametrize("scale", [2.0, 1.3])
def test_an_arm_that_has_become_heavier_is_noticed_and_learned_at_once(
    solved: Callable[..., Learner], scale: float
) -> None:
    heavier, errors, said = TwoLinkArm(inertia_scale=scale), [], []
    for detect in (True, False):
        learner = solved(detect_change=detect)
        for seed in range(3):
            learner, outcome = learner.trained_on(noisy(trial(5.0), seed), "actual")
            assert CHANGED not in " ".join(outcome.grown)
        learner, outcome = learner.trained_on(noisy(trial(5.0, arm=heavier), 9), "actual")
        said.append(" ".join(outcome.grown).count(CHANGED))
        errors.append(held_out_error(learner, heavier))
    assert said == [1, 0]
    assert errors[0] < 3.0 * NOISE_RAD
    assert errors[1] > 10.0 * errors[0]


def test_after_a_change_the_same_arm_is_not_taken_for_yet_another(solved: Callable[..., Learner]) -> None:
    heavier, learner = TwoLinkArm(inertia_scale=2.0), solved()
    for seed in range(3):
        learner, _ = learner.trained_on(noisy(trial(5.0), seed), "actual")
    said = []
    for seed in range(4):
        learner, outcome = learner.trained_on(noisy(trial(5.0, arm=heavier), 10 + seed), "actual")
        said.append(CHANGED in " ".join(outcome.grown))
    assert said == [True, False, False, False]


@pytest.mark.parametrize("noise_rad", [0.0, NOISE_RAD])
def test_the_same_arm_at_rising_speeds_is_not_taken_for_another(
    solved: Callable[..., Learner], noise_rad: float
) -> None:
    learner = solved()
    for k, duration_s in enumerate(DURATIONS_S):
        learner, outcome = learner.trained_on(noisy(trial(duration_s), k, noise_rad), "actual")
        assert CHANGED not in " ".join(outcome.grown), f"at {duration_s} s"


@pytest.mark.parametrize("times", [2.0, 10.0])
def test_the_same_arm_with_more_noise_is_not_taken_for_another(
    solved: Callable[..., Learner], times: float
) -> None:
    learner = solved()
    for k, duration_s in enumerate(DURATIONS_S):
        noise_rad = NOISE_RAD if k < 3 else times * NOISE_RAD
        learner, outcome = learner.trained_on(noisy(trial(duration_s), k, noise_rad), "actual")
        assert CHANGED not in " ".join(outcome.grown), f"at {duration_s} s"


def test_the_memory_is_bounded_and_what_was_thinned_out_is_still_known() -> None:
    learner = untrained(memory_samples=1000)
    for seed, duration_s in enumerate((11.5, 9.0, 7.0, 6.0, 5.0, 4.5)):
        learner, _ = learner.trained_on(noisy(trial(duration_s, step=5), seed), "actual")
        arrays = learner.stored().arrays
        assert len(arrays["memory_weight"]) <= 1000
    assert set(arrays["memory_trial"]) == set(range(6))
    for duration_s in (11.5, 7.0, 4.5):
        wanted = rms(trial(duration_s, first=5).offset_rad)
        assert held_out_error(learner, duration_s=duration_s) < 0.03 * wanted


def with_spring(samples: TrainingSamples) -> TrainingSamples:
    """Return a trial of an arm with something on it that is no rigid body."""
    spring = 0.05 * np.sin(3.0 * samples.actual[:, :2])
    return dataclasses.replace(samples, offset_rad=samples.offset_rad + spring)


def test_on_top_of_rigid_links_trees_learn_what_these_leave_over() -> None:
    pytest.importorskip("pinocchio")
    both, links = (OURS[name].new(context()) for name in ("rigid_body+lms_tree", "rigid_body"))
    for seed, duration_s in enumerate(DURATIONS_S):
        samples = noisy(with_spring(trial(duration_s)), seed)
        both, links = (one.trained_on(samples, "actual")[0] for one in (both, links))
    held_out = with_spring(trial(4.5, first=5))
    errors = [rms(held_out.offset_rad - one.predict(held_out.actual)) for one in (both, links)]
    assert errors[0] < 0.4 * errors[1]
    assert both.stored().header["silent"] == [False, False]


def test_where_nothing_was_practised_trees_leave_the_answer_to_the_rigid_links() -> None:
    """At other postures, and through the same ones in another direction; not at another speed."""
    pytest.importorskip("pinocchio")
    both = OURS["rigid_body+lms_tree"].new(context(gaussians_per_input=6))
    for duration_s in (9.0, 7.0, 5.0):
        whole = with_spring(trial(duration_s))
        arc = slice(len(whole.actual) // 4)  # all of it crosses itself
        samples = TrainingSamples(whole.actual[arc], whole.desired[arc], whole.offset_rad[arc])
        both, _ = both.trained_on(samples, "actual")
    assert isinstance(both, LeastSquaresLearner)
    assert both.base is not None
    links, seen = both.base.predict, trial(4.5).actual[20 : len(trial(4.5).actual) // 5]
    there, back, elsewhere = (
        rms(both.predict(inputs) - links(inputs))
        for inputs in (seen, seen * [1, 1, -1, -1, 1, 1], seen + [1.5, 1.5, 0, 0, 0, 0])
    )
    assert there > 1e-3
    assert max(back, elsewhere) < 0.01 * there


def test_on_top_of_rigid_links_that_are_right_trees_keep_silent() -> None:
    pytest.importorskip("pinocchio")
    both = practised(OURS["rigid_body+lms_tree"].new(context(gaussians_per_input=6)))
    links = practised(OURS["rigid_body"].new(context()))
    assert both.stored().header["silent"] == [True, True]
    inputs = trial(4.0, step=25).actual
    np.testing.assert_allclose(both.predict(inputs), links.predict(inputs), atol=1e-12)


def error_with_noise(noise_rad_s2: float, told: bool) -> float:
    """Return the relative error after a slow trial with noise in its accelerations."""
    exact = trial(11.5, step=2)
    actual = exact.actual.copy()
    actual[:, 4:] += noise_rad_s2 * np.random.default_rng(0).normal(size=(len(actual), 2))
    known = np.array([0.0, 0.0, 0.0, 0.0, noise_rad_s2, noise_rad_s2]) if told else np.empty(0)
    samples = dataclasses.replace(exact, actual=actual, input_noise=known)
    learner, _ = untrained(gaussians_per_input=10).trained_on(samples, "actual")
    return held_out_error(learner, duration_s=11.5) / rms(exact.offset_rad)


def test_to_know_the_noise_of_accelerations_helps_while_there_is_motion_above_it() -> None:
    assert error_with_noise(1.0, told=True) < 0.7 * error_with_noise(1.0, told=False)


@pytest.mark.parametrize("noise_rad_s2", [3.0, 6.0])
def test_to_know_noise_in_which_all_motion_sinks_does_little_harm(noise_rad_s2: float) -> None:
    untold, told = (error_with_noise(noise_rad_s2, told=told) for told in (False, True))
    assert told < 3.0 * untold


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("n", [1, 2, 5])
def test_what_a_trial_that_was_broken_off_leaves_is_learned_however_little(n: int) -> None:
    rows = np.linspace(60, 180, n).astype(int)
    whole = trial(5.0)
    few = dataclasses.replace(
        whole, actual=whole.actual[rows], desired=whole.desired[rows], offset_rad=whole.offset_rad[rows]
    )
    learner, outcome = untrained().trained_on(few, "actual")
    assert outcome.training_rms_after_rad < 0.5 * outcome.training_rms_before_rad
    assert np.all(np.isfinite(learner.predict(whole.actual)))
    learner, _ = learner.trained_on(whole, "actual")
    assert held_out_error(learner) < 0.05 * rms(whole.offset_rad)
