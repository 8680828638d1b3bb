"""The samples that are kept."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from tel_ros.core.learning.experience import SampleMemory, counted, thinning
from tel_ros.core.learning.signals import TrainingSamples


def samples(n: int, **known: object) -> TrainingSamples:
    inputs = np.arange(6.0 * n).reshape(n, 6)
    return TrainingSamples(actual=inputs, desired=inputs, offset_rad=inputs[:, :2], **known)


def of_trial(trial: int, n: int, **known: object) -> SampleMemory:
    pairs = samples(n, **known)
    return SampleMemory.of_trial(pairs, pairs.actual + 1000.0 * trial, pairs.offset_rad, trial)


def of_trials(*sizes: int) -> SampleMemory:
    memory = SampleMemory.empty(2)
    for trial, n in enumerate(sizes):
        memory = memory.joined(of_trial(trial, n))
    return memory


def weights(memory: SampleMemory, trial: int) -> np.ndarray:
    return memory.weight[memory.trial == trial]


def test_an_empty_memory_has_no_samples() -> None:
    memory = SampleMemory.empty(3)
    assert len(memory) == 0
    assert memory.inputs.shape == (0, 9)
    assert memory.targets_rad.shape == (0, 3)


def test_a_trial_is_kept_whole_if_nothing_is_known_about_its_bandwidth() -> None:
    memory, pairs = of_trial(4, 30), samples(30)
    np.testing.assert_array_equal(memory.inputs, pairs.actual + 4000.0)
    np.testing.assert_array_equal(memory.targets_rad, pairs.offset_rad)
    np.testing.assert_array_equal(memory.weight, 1.0)
    np.testing.assert_array_equal(memory.trial, 4)
    np.testing.assert_array_equal(memory.noise, np.zeros((30, 6)))


@pytest.mark.parametrize(
    ("bandwidth_hz", "period_s", "step"),
    [(10.0, 0.002, 10), (20.0, 0.001, 10), (15.0, 0.002, 6), (250.0, 0.002, 1)],
)
def test_of_what_a_filter_has_smoothed_five_samples_a_period_are_kept(
    bandwidth_hz: float, period_s: float, step: int
) -> None:
    memory = of_trial(0, 100, bandwidth_hz=bandwidth_hz, period_s=period_s)
    np.testing.assert_array_equal(memory.inputs, samples(100).actual[::step])
    np.testing.assert_array_equal(memory.targets_rad, samples(100).offset_rad[::step])


def test_the_noise_of_a_trial_goes_with_each_of_its_samples() -> None:
    noise = np.linspace(0.0, 0.5, 6)
    memory = of_trial(0, 5, input_noise=noise).joined(of_trial(1, 2))
    np.testing.assert_array_equal(memory.noise, [*[noise] * 5, *[np.zeros(6)] * 2])


def test_memories_are_joined_one_behind_the_other() -> None:
    memory = of_trials(3, 2)
    np.testing.assert_array_equal(memory.trial, [0, 0, 0, 1, 1])
    np.testing.assert_array_equal(memory.inputs[3:], of_trial(1, 2).inputs)
    assert len(memory) == 5


def test_rows_are_taken_from_all_columns() -> None:
    memory = of_trials(3, 2)
    some = memory[np.array([False, True, False, False, True])]
    np.testing.assert_array_equal(some.trial, [0, 1])
    np.testing.assert_array_equal(some.inputs, memory.inputs[[1, 4]])
    np.testing.assert_array_equal(some.targets_rad, memory.targets_rad[[1, 4]])


def test_a_memory_that_is_not_too_long_stays_the_same() -> None:
    memory = of_trials(3, 2)
    assert memory.bounded(5) is memory


@pytest.mark.parametrize(
    "sizes", [(1000,), (400, 400, 400), (37, 911, 5, 300), (1, 1, 1, 1200), tuple([90] * 30)]
)
@pytest.mark.parametrize("most", [1000, 333, 100])
def test_a_memory_never_gets_longer_than_it_may(sizes: tuple[int, ...], most: int) -> None:
    memory = of_trials(*sizes)
    bounded = memory.bounded(most)
    assert len(bounded) <= most
    # It is thinned by quarters or halves, not emptied.
    assert len(bounded) >= min(len(memory), most) // 2


def test_thinning_conserves_the_total_weight() -> None:
    memory = of_trials(256, 512, 128)
    bounded = memory.bounded(300)
    assert bounded.weight.sum() == memory.weight.sum()


@pytest.mark.parametrize("sizes", [(301, 77, 905), (999,), (5, 5, 5, 1201)])
def test_what_odd_numbers_add_to_the_weight_is_little(sizes: tuple[int, ...]) -> None:
    memory = of_trials(*sizes)
    assert memory.bounded(200).weight.sum() == pytest.approx(memory.weight.sum(), rel=0.02)


def test_the_oldest_trials_are_thinned_first_and_the_newest_last() -> None:
    memory = of_trials(400, 400, 400, 400).bounded(1200)
    assert [len(weights(memory, trial)) for trial in range(4)] == [200, 200, 400, 400]
    assert [weights(memory, trial).max() for trial in range(4)] == [2.0, 2.0, 1.0, 1.0]
    further = memory.joined(of_trial(4, 400)).bounded(1200)
    kept = [len(weights(further, trial)) for trial in range(5)]
    assert kept == sorted(kept)
    assert kept[4] == 400
    assert kept[0] > 0


def test_what_is_left_of_a_trial_is_spread_over_all_of_it() -> None:
    memory = of_trials(400, 400).bounded(700)
    first = memory.inputs[memory.trial == 0]
    np.testing.assert_array_equal(first, of_trial(0, 400).inputs[::2])
    np.testing.assert_array_equal(memory.inputs[memory.trial == 1], of_trial(1, 400).inputs)


def test_it_comes_back_from_its_arrays() -> None:
    memory = of_trials(6, 4)
    memory = dataclasses.replace(memory, weight=0.3 * memory.weight).bounded(8)
    back = SampleMemory.restored(memory.arrays(), 2)
    for field in dataclasses.fields(SampleMemory):
        np.testing.assert_array_equal(getattr(back, field.name), getattr(memory, field.name))


@pytest.mark.parametrize("name", ["inputs", "targets_rad", "noise", "weight", "trial", "trust"])
@pytest.mark.parametrize("damage", ["shorter", "other joints", "nan"])
def test_arrays_that_do_not_fit_together_are_refused(name: str, damage: str) -> None:
    arrays = of_trials(6, 4).arrays()
    array = arrays[f"memory_{name}"].astype(float)
    if damage == "nan":
        array.flat[0] = np.nan
    else:
        array = array[1:] if damage == "shorter" else array[..., None]
    with pytest.raises(ValueError, match=r"memory_.* has shape .*; expected finite numbers of"):
        SampleMemory.restored(arrays | {f"memory_{name}": array}, 2)


def half_trusted(n: int) -> SampleMemory:
    return dataclasses.replace(of_trial(0, n), trust=np.linspace(0.1, 1.0, 2 * n).reshape(n, 2))


def test_trust_goes_with_its_samples() -> None:
    memory = half_trusted(6)
    kept = memory.joined(of_trial(1, 3))[np.arange(9) % 2 == 0]
    np.testing.assert_array_equal(kept.trust[:3], memory.trust[::2])
    np.testing.assert_array_equal(kept.trust[3:], 1.0)
    np.testing.assert_array_equal(SampleMemory.restored(memory.arrays(), 2).trust, memory.trust)
    np.testing.assert_array_equal(memory.bounded(3).trust, memory.trust[::2])


def test_a_file_without_trust_is_read_as_believed() -> None:
    arrays = half_trusted(6).arrays()
    del arrays["memory_trust"]
    np.testing.assert_array_equal(SampleMemory.restored(arrays, 2).trust, np.ones((6, 2)))


def test_the_thinning_is_that_of_the_memory() -> None:
    pairs = samples(100, bandwidth_hz=15.0, period_s=0.002)
    memory = SampleMemory.of_trial(pairs, pairs.actual, pairs.offset_rad, 0)
    np.testing.assert_array_equal(memory.inputs, pairs.actual[:: thinning(pairs)])


def test_errors_count_as_far_as_they_are_believed() -> None:
    rng = np.random.default_rng(0)
    error, trust = rng.normal(size=(50, 2)), rng.uniform(0.01, 1.0, size=(50, 2))
    expected = np.sum(trust * error**2, axis=0) / np.sum(trust, axis=0)
    np.testing.assert_allclose(np.mean(counted(error, trust) ** 2, axis=0), expected)
