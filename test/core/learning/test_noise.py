"""Noise of recorded positions, the cutoff that it asks for, and joints that may stick."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product

import numpy as np
import pytest
from scipy.signal import butter, sosfilt

from tel_ros.core.learning.experience import stuck_trust
from tel_ros.core.learning.noise import (
    SLOWEST_SLIDING_RAD_S,
    choose_cutoff_hz,
    derivative_noise,
    derivatives,
    low_pass,
    sensor_noise,
    slides_throughout,
)
from tel_ros.core.trajectories.paths import NAMED_PATHS
from tel_ros.core.trajectories.trajectory import sample

DT_S = 0.002


def motion(duration_s: float = 4.5, rate_hz: float = 500.0) -> np.ndarray:
    """Return the project's figure from rest to rest, free of noise. Shape (n, 2)."""
    return sample(NAMED_PATHS["planar_loops"], duration_s, rate_hz).position_rad


def white(values: np.ndarray, noise_rad: float, seed: int = 0) -> np.ndarray:
    return values + noise_rad * np.random.default_rng(seed).normal(size=values.shape)


def encoder(values: np.ndarray, bits: int) -> np.ndarray:
    step = 2 * np.pi / 2**bits
    return np.round(values / step) * step


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("noise_rad", [1e-4, 1e-3, 1e-2])
@pytest.mark.parametrize("duration_s", [4.5, 11.5])
def test_white_noise_on_a_moving_arm_is_found(noise_rad: float, duration_s: float, seed: int) -> None:
    found = sensor_noise(white(motion(duration_s), noise_rad, seed), DT_S)
    np.testing.assert_allclose(found, noise_rad, rtol=0.1)


def test_each_joint_has_a_noise_of_its_own() -> None:
    clean, noisy = motion(), white(motion(), 1e-3)
    found = sensor_noise(np.column_stack([clean[:, 0], noisy[:, 1]]), DT_S)
    assert found[0] < 1e-5
    assert found[1] == pytest.approx(1e-3, rel=0.1)


@pytest.mark.parametrize("bits", [12, 14, 16])
@pytest.mark.parametrize("duration_s", [4.5, 6.8, 9.2, 11.5])
def test_an_encoder_has_the_noise_of_rounding(bits: int, duration_s: float) -> None:
    # Uniform within a step; a joint that passes one within a few periods makes it nearly white.
    expected = 2 * np.pi / 2**bits / np.sqrt(12)
    np.testing.assert_allclose(sensor_noise(encoder(motion(duration_s), bits), DT_S), expected, rtol=0.2)


def test_motion_is_not_taken_for_noise() -> None:
    # A sixteen-bit encoder has 28 µrad.
    assert np.all(sensor_noise(motion(), DT_S) < 3e-6)


@pytest.mark.parametrize("n", [50, 100, 500])
def test_short_records_give_the_right_noise_on_average(n: int) -> None:
    rng = np.random.default_rng(n)
    found = np.array([sensor_noise(rng.normal(size=(n, 2)), DT_S) for _ in range(200)])
    # The scatter of one is 0.3 with 50 samples, so that of the mean of 400 is 0.015.
    assert np.sqrt(np.mean(found**2)) == pytest.approx(1.0, abs=0.08)


def test_the_cutoff_rises_with_speed() -> None:
    for noise_rad in (1e-4, 1e-3):
        cutoffs = [choose_cutoff_hz(white(motion(d), noise_rad), DT_S) for d in (11.5, 6.8, 4.5, 2.5)]
        assert cutoffs == sorted(cutoffs), noise_rad
        assert cutoffs[-1] > 2.0 * cutoffs[0], noise_rad


@pytest.mark.parametrize("duration_s", [4.5, 11.5])
def test_the_cutoff_falls_with_noise(duration_s: float) -> None:
    values = motion(duration_s)
    cutoffs = [choose_cutoff_hz(white(values, noise), DT_S) for noise in (1e-6, 1e-5, 1e-4, 1e-3, 1e-2)]
    assert cutoffs == sorted(cutoffs, reverse=True)
    assert cutoffs[0] > 2.0 * cutoffs[-1]


@pytest.mark.parametrize(
    ("duration_s", "low_hz", "high_hz"), [(11.5, 3.0, 8.0), (6.8, 4.0, 10.0), (4.5, 5.0, 13.0)]
)
def test_the_cutoff_for_a_usual_encoder_is_where_the_motion_ends(
    duration_s: float, low_hz: float, high_hz: float
) -> None:
    """The figure has three turns in its duration; starting, stopping and the window add what is faster."""
    assert low_hz <= choose_cutoff_hz(encoder(motion(duration_s), 16), DT_S) <= high_hz


def test_the_fastest_joint_decides() -> None:
    t = np.arange(0.0, 4.0, DT_S)[:, None]
    slow, fast = (white(np.sin(2 * np.pi * hz * t), 1e-3) for hz in (0.3, 6.0))
    alone = [choose_cutoff_hz(values, DT_S) for values in (slow, fast)]
    assert alone[0] < 5.0 < 9.0 <= alone[1]
    assert choose_cutoff_hz(np.hstack([slow, fast]), DT_S) == alone[1]


def test_a_gap_between_harmonics_is_motion_and_mains_hum_is_not() -> None:
    t = np.arange(0.0, 6.0, DT_S)[:, None]
    values = white(0.4 * np.sin(2 * np.pi * 0.5 * t) + 2e-3 * np.sin(2 * np.pi * 5.0 * t), 1e-4)
    cutoff_hz = choose_cutoff_hz(values, DT_S)
    assert 1.5 * 5.0 <= cutoff_hz <= 1.5 * 7.0, "the line at 5 Hz, as broad as the window makes it"
    assert choose_cutoff_hz(values + 1e-3 * np.sin(2 * np.pi * 30.0 * t), DT_S) == cutoff_hz


@pytest.mark.parametrize("duration_s", [4.5, 6.8, 9.2, 11.5])
@pytest.mark.parametrize("rate_hz", [10.0, 25.0])
def test_at_a_low_rate_a_motion_without_noise_is_left_alone(rate_hz: float, duration_s: float) -> None:
    values = motion(duration_s, rate_hz)
    assert choose_cutoff_hz(values, 1.0 / rate_hz) == 0.0


@pytest.mark.parametrize("amplitude_rad", [0.0, 2e-3])
def test_at_a_low_rate_a_joint_that_hardly_moves_changes_nothing(amplitude_rad: float) -> None:
    values = motion(4.5, 25.0)
    values[:, 1] = 0.7 + amplitude_rad * np.sin(np.pi * np.arange(len(values)) * 0.04)
    assert choose_cutoff_hz(white(values, 1e-5), 0.04) == 0.0


@pytest.mark.parametrize("rate_hz", [5.0, 10.0, 25.0, 50.0, 100.0, 500.0, 2000.0])
def test_the_filter_for_noisy_positions_fits_the_rate(rate_hz: float) -> None:
    cutoff_hz = choose_cutoff_hz(white(motion(11.5, rate_hz), 3e-3), 1.0 / rate_hz)
    assert min(3.0, 0.4 * rate_hz) <= cutoff_hz <= min(0.4 * rate_hz, max(0.1 * rate_hz, 20.0))


@pytest.mark.parametrize("order", [4, 6])
@pytest.mark.parametrize("noise_rad", [1e-3, 1e-2])
def test_noise_that_is_not_white_is_not_left_unfiltered(noise_rad: float, order: int) -> None:
    """A drive that filters its positions hides their noise where it is looked for, not where it does harm."""
    noise = white(np.zeros((2251, 2)), noise_rad)
    noise = sosfilt(butter(order, 60.0, fs=500.0, output="sos"), noise, axis=0)
    assert choose_cutoff_hz(motion() + noise, DT_S) == 50.0


@pytest.mark.parametrize("seed", range(3))
def test_at_a_low_rate_a_motion_that_goes_up_to_half_of_it_is_not_taken_for_noise(seed: int) -> None:
    values = np.random.default_rng(seed).normal(size=(600, 2))
    values = sosfilt(butter(4, 4.0, fs=25.0, output="sos"), values, axis=0)[100:]
    assert choose_cutoff_hz(values, 0.04) == 0.0


COURSES: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "zero": lambda t: 0.0 * t,
    "still": lambda t: 0.0 * t + 0.6,
    "ramp": lambda t: t,
    "one moves": lambda t: np.hstack([np.full_like(t, 0.6), np.sin(3.0 * t)]),
    "noise": lambda t: white(0.0 * t, 1e-3),
    "encoder": lambda t: encoder(np.sin(t), 16),
    "jumps": lambda t: np.sign(np.sin(40.0 * t)),
}


@pytest.mark.filterwarnings("error")
def test_any_record_gets_a_usable_answer() -> None:
    for name, n, period_s in product(COURSES, (50, 51, 77, 300), (5e-4, 0.002, 0.01, 0.04, 0.2)):
        values = COURSES[name](np.arange(n)[:, None] * period_s)
        sigma, cutoff_hz = sensor_noise(values, period_s), choose_cutoff_hz(values, period_s)
        assert sigma.shape == (values.shape[1],), (name, n, period_s)
        assert np.all(np.isfinite(sigma)) and np.all(sigma >= 0.0), (name, n, period_s)
        assert 0.0 <= cutoff_hz < 0.5 / period_s, (name, n, period_s)


def test_a_joint_that_stands_still_has_no_noise() -> None:
    np.testing.assert_array_equal(sensor_noise(np.full((500, 2), 0.6), DT_S), 0.0)
    assert choose_cutoff_hz(np.full((500, 2), 0.6), DT_S) == 50.0


def test_without_a_filter_differences_make_the_noise_that_they_are_known_for() -> None:
    # (x₊ - x₋) / 2 dt, and of two of those the difference over dt: four terms of 1 / 2 dt².
    expected = [1.0, 1.0 / (np.sqrt(2.0) * DT_S), 1.0 / DT_S**2]
    np.testing.assert_allclose(derivative_noise(0.0, DT_S), expected, rtol=1e-12)
    np.testing.assert_allclose(derivative_noise(250.0, DT_S), expected, rtol=1e-12)


@pytest.mark.parametrize("cutoff_hz", [3.0, 8.0, 15.0, 50.0])
def test_noise_behind_the_filter_is_as_predicted(cutoff_hz: float) -> None:
    noise = np.random.default_rng(0).normal(size=(20_000, 20))
    position = low_pass(noise, cutoff_hz, DT_S)
    found = [values[2000:-2000].std() for values in (position, *derivatives(position, DT_S))]
    # 20 records of 32 s at 6 Hz of bandwidth and more: 3,800 independent values have 1.2 % of scatter.
    np.testing.assert_allclose(derivative_noise(cutoff_hz, DT_S), found, rtol=0.04)


@pytest.mark.parametrize(("cutoff_hz", "expected"), [(8.0, 0.180), (12.0, 0.495), (15.0, 0.863)])
def test_a_lower_cutoff_has_much_less_noise_of_acceleration(cutoff_hz: float, expected: float) -> None:
    assert 1e-3 * derivative_noise(cutoff_hz, DT_S)[2] == pytest.approx(expected, abs=1e-3)


@pytest.mark.parametrize("cutoff_hz", [0.0, -1.0, 250.0, 1000.0])
def test_a_filter_that_is_switched_off_changes_nothing(cutoff_hz: float) -> None:
    values = white(motion(), 1e-3)
    np.testing.assert_array_equal(low_pass(values, cutoff_hz, DT_S), values)


NO_NOISE = np.zeros(1)


def column(*values: float) -> np.ndarray:
    return np.array(values)[:, None]


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_joint_slides_where_all_its_neighbours_move_the_same_way(sign: float) -> None:
    velocity = sign * column(1.0, 1.0, 1.0, 1.0, -1.0, -1.0, -1.0, -1.0)
    found = slides_throughout(velocity, NO_NOISE, reach=1)
    np.testing.assert_array_equal(found, column(1, 1, 1, 0, 0, 1, 1, 1) > 0)
    found = slides_throughout(velocity, NO_NOISE, reach=3)
    np.testing.assert_array_equal(found, column(1, 0, 0, 0, 0, 0, 0, 1) > 0)


def test_a_joint_that_creeps_may_stick() -> None:
    creeping, sliding = 0.9 * SLOWEST_SLIDING_RAD_S, 1.1 * SLOWEST_SLIDING_RAD_S
    found = slides_throughout(np.tile([creeping, sliding, -sliding], (5, 1)), np.zeros(3), reach=1)
    np.testing.assert_array_equal(found, np.tile([False, True, True], (5, 1)))


def test_movement_has_to_stand_out_of_the_noise() -> None:
    velocity = np.full((5, 2), 0.2)
    found = slides_throughout(velocity, np.array([0.05, 0.1]), reach=1)
    np.testing.assert_array_equal(found, np.tile([True, False], (5, 1)))


def test_each_joint_has_its_own_answer() -> None:
    velocity = np.column_stack([np.ones(6), np.zeros(6)])
    found = slides_throughout(velocity, np.zeros(2), reach=1)
    assert found[:, 0].all() and not found[:, 1].any()


def test_trust_is_the_ratio_of_the_variances_of_sliding_and_sticking() -> None:
    """A torque that may be anything within ±c has the variance c² / 3."""
    sliding = np.array([[True], [True], [False], [False]])
    residual = column(0.01, -0.01, 5.0, 7.0)
    (found,) = stuck_trust(residual, sliding, np.array([0.3]))
    assert found == pytest.approx(1e-4 / (1e-4 + 0.03))


def test_without_dry_friction_every_sample_is_believed() -> None:
    sliding = np.array([[True], [False]])
    np.testing.assert_array_equal(stuck_trust(column(0.01, 5.0), sliding, np.zeros(1)), 1.0)
    np.testing.assert_array_equal(stuck_trust(column(0.0, 5.0), sliding, np.zeros(1)), 1.0)


def test_a_joint_that_never_slides_is_believed_because_there_is_nothing_else() -> None:
    sliding = np.zeros((3, 1), dtype=bool)
    np.testing.assert_array_equal(stuck_trust(column(1.0, 2.0, 3.0), sliding, np.array([0.3])), 1.0)


def test_trust_never_becomes_nothing() -> None:
    sliding = np.array([[True], [False]])
    (found,) = stuck_trust(column(0.0, 5.0), sliding, np.array([0.3]))
    assert 0.0 < found < 1e-9
