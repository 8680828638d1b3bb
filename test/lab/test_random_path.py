"""Random smooth paths: within their range, smooth, repeatable and worth practising."""

from __future__ import annotations

import numpy as np
import pytest

from tel_lab.random_path import random_smooth_path
from tel_ros.core.errors import ConfigError
from tel_ros.core.trajectories.paths import NAMED_PATHS, Path
from tel_ros.core.trajectories.trajectory import sample

LOW, HIGH = (-2.6, -2.6), (2.6, 2.6)
S = np.linspace(0.0, 1.0, 2001)


def peak_acceleration_rad_s2(path: Path) -> float:
    return float(np.abs(sample(path, 4.5, 200.0).acceleration_rad_s2).max())


@pytest.mark.parametrize(
    ("low_rad", "high_rad"),
    [(LOW, HIGH), ((0.1, -1.0, 2.0), (0.3, 3.0, 2.5)), ((-1e-3,), (1e-3,)), ((-3.0,) * 7, (3.0,) * 7)],
    ids=["wide", "unequal", "narrow", "seven joints"],
)
def test_a_random_path_stays_inside_its_range(
    low_rad: tuple[float, ...], high_rad: tuple[float, ...]
) -> None:
    for seed in range(50):
        path = random_smooth_path(seed, low_rad, high_rad)
        q, _, _ = path.evaluate(S)
        assert q.shape == (len(S), path.n_joints) == (len(S), len(low_rad))
        assert np.all(q >= low_rad)
        assert np.all(q <= high_rad)


@pytest.mark.parametrize("seed", range(8))
def test_derivatives_of_a_random_path_are_those_of_its_positions(seed: int) -> None:
    path, h, s = random_smooth_path(seed, LOW, HIGH), 1e-5, np.linspace(0.0, 1.0, 301)
    _, dq, ddq = path.evaluate(s)
    (above, dq_above, _), (below, dq_below, _) = path.evaluate(s + h), path.evaluate(s - h)
    # Truncation h² q''' / 6 with q''' < 0.9 (6π)³ = 6e3, its derivative 20 times that; rounding 1e-16 / h.
    np.testing.assert_allclose(dq, (above - below) / (2 * h), atol=1e-6)
    np.testing.assert_allclose(ddq, (dq_above - dq_below) / (2 * h), atol=1e-5)


def test_equal_seeds_give_equal_paths_and_others_give_others() -> None:
    def positions(seed: int) -> np.ndarray:
        return random_smooth_path(seed, LOW, HIGH).evaluate(S)[0]

    np.testing.assert_array_equal(positions(5), positions(5))
    for seed in range(20):
        assert np.abs(positions(seed) - positions(seed + 1)).max() > 0.1


def test_some_random_paths_are_closed_and_some_are_open() -> None:
    gaps_rad = []
    for seed in range(40):
        ends, _, _ = random_smooth_path(seed, LOW, HIGH).evaluate(np.array([0.0, 1.0]))
        gaps_rad.append(float(np.abs(ends[1] - ends[0]).max()))
    closed = sum(gap_rad < 1e-12 for gap_rad in gaps_rad)  # a sine of 6π as a float
    assert 10 <= closed <= 30
    assert max(gaps_rad) > 0.5


def test_random_paths_are_about_as_demanding_as_the_built_in_one() -> None:
    built_in = peak_acceleration_rad_s2(NAMED_PATHS["planar_loops"])
    ratios = [peak_acceleration_rad_s2(random_smooth_path(seed, LOW, HIGH)) / built_in for seed in range(100)]
    assert 0.7 < np.median(ratios) < 1.2
    assert min(ratios) > 0.2
    assert max(ratios) < 2.0


@pytest.mark.parametrize(
    ("low_rad", "high_rad", "message"),
    [
        ((0.0, 0.0), (1.0, 0.0), r"high_rad is \[1.0, 0.0\]; expected finite angles above \[0.0, 0.0\]"),
        ((0.0,), (1.0, 2.0), r"high_rad is \[1.0, 2.0\]"),
        ((-np.inf,), (1.0,), r"low_rad is \[-inf\]; expected finite angles"),
        ((0.0,), (np.nan,), r"high_rad is \[nan\]"),
        ((), (), r"low_rad is \[\]"),
        (0.0, 1.0, "low_rad is 0.0"),
    ],
)
def test_a_range_that_is_none_is_refused(low_rad: object, high_rad: object, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        random_smooth_path(1, low_rad, high_rad)


def test_a_negative_seed_is_refused() -> None:
    with pytest.raises(ConfigError, match="seed is -1; expected a whole number of at least 0"):
        random_smooth_path(-1, LOW, HIGH)
