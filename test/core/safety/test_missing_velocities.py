"""Velocities of an arm that reports none, as the gate for joint states estimates them."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tel_ros.core.errors import StateError
from tel_ros.core.safety.gate import MissingVelocities
from tel_ros.core.types import NS_PER_S, FloatArray

PERIOD_S = 0.002
CUTOFF_HZ = 100.0


def estimator(n_joints: int = 1, cutoff_hz: float = CUTOFF_HZ) -> MissingVelocities:
    return MissingVelocities(n_joints, cutoff_hz=cutoff_hz, max_gap_s=0.1)


def update(estimate: MissingVelocities, time_ns: int, *position_rad: float) -> FloatArray:
    """Return the estimates for joints that report no velocity."""
    return estimate.fill(time_ns, np.array(position_rad), np.full(len(position_rad), np.nan))


def run(estimate: MissingVelocities, time_s: FloatArray, position_rad: FloatArray) -> FloatArray:
    """Return the estimates for one joint."""
    stamps = np.round(time_s * NS_PER_S).astype(np.int64).tolist()
    return np.array([update(estimate, ns, q)[0] for ns, q in zip(stamps, position_rad, strict=True)])


def lag_s(cutoff_hz: float, period_s: float) -> float:
    """Return the lag that the documentation states."""
    return period_s / 2.0 + period_s / math.expm1(2.0 * math.pi * cutoff_hz * period_s)


@pytest.mark.parametrize("jitter", [0.0, 0.4])
def test_a_constant_velocity_is_found_also_when_the_stamps_jitter(jitter: float) -> None:
    rng = np.random.default_rng(1)
    time_s = np.cumsum(PERIOD_S * (1.0 + jitter * rng.uniform(-1.0, 1.0, 200)))
    velocity = run(estimator(), time_s, 0.3 - 0.7 * time_s)
    # Stamps are whole nanoseconds: 0.5 ns of at least 1.2 ms.
    assert velocity[1:] == pytest.approx(-0.7, rel=1e-6)
    assert velocity[0] == 0.0


@pytest.mark.parametrize("cutoff_hz", [20.0, 100.0, 2000.0])
@pytest.mark.parametrize("period_s", [0.001, 0.002, 0.01])
def test_at_constant_acceleration_the_estimate_is_late_by_the_stated_lag(
    cutoff_hz: float, period_s: float
) -> None:
    time_s = period_s * np.arange(500)
    estimate = estimator(cutoff_hz=cutoff_hz)
    velocity = run(estimate, time_s, 0.5 * 3.0 * time_s**2)
    assert time_s[-1] - velocity[-1] / 3.0 == pytest.approx(lag_s(cutoff_hz, period_s), rel=1e-6)


def test_the_lag_at_500_hz_and_100_hz_is_that_of_the_documentation() -> None:
    assert lag_s(CUTOFF_HZ, PERIOD_S) == pytest.approx(1.80e-3, abs=5e-6)


def test_a_sine_at_the_corner_frequency_is_damped_by_about_3_db() -> None:
    period_s = 1e-4  # so short that the difference itself changes nothing
    time_s = period_s * np.arange(4000)
    omega = 2.0 * math.pi * 20.0
    velocity = run(estimator(cutoff_hz=20.0), time_s, np.sin(omega * time_s) / omega)
    assert np.abs(velocity[2000:]).max() == pytest.approx(math.sqrt(0.5), rel=0.01)


def test_it_looks_back_only() -> None:
    time_s = PERIOD_S * np.arange(100)
    position = np.sin(5.0 * time_s)
    other = position.copy()
    other[60:] = 3.0
    first, second = run(estimator(), time_s, position), run(estimator(), time_s, other)
    assert np.array_equal(first[:60], second[:60])
    assert not np.array_equal(first[60:], second[60:])


@pytest.mark.parametrize("bits", [12, 16])
def test_one_encoder_step_makes_no_more_velocity_than_stated(bits: int) -> None:
    step_rad = 2.0 * math.pi / 2**bits
    position = np.where(np.arange(50) < 20, 0.0, step_rad)
    peak = np.abs(run(estimator(), PERIOD_S * np.arange(50), position)).max()
    assert peak == pytest.approx(step_rad * (1.0 - math.exp(-2.0 * math.pi * 0.2)) / PERIOD_S)
    assert peak == pytest.approx({12: 0.55, 16: 0.034}[bits], rel=0.02)


def test_a_state_that_is_sent_again_changes_nothing() -> None:
    estimate, plain = estimator(), estimator()
    for k in range(1, 20):
        ns, position = k * 2_000_000, 0.01 * k * k
        repeated = [update(estimate, ns, position)[0] for _ in range(3)]
        assert repeated == [update(plain, ns, position)[0]] * 3


@pytest.mark.parametrize("jump_ns", [101_000_000, -50_000_000])
def test_it_begins_anew_after_a_gap_or_when_stamps_go_back(jump_ns: int) -> None:
    estimate = estimator()
    for k in range(1, 50):
        update(estimate, k * 2_000_000, 0.01 * k)
    resumed_ns = 49 * 2_000_000 + jump_ns
    assert update(estimate, resumed_ns, 2.0)[0] == 0.0
    assert update(estimate, resumed_ns + 2_000_000, 2.001)[0] == pytest.approx(0.5)


def test_a_gap_just_short_of_the_limit_is_bridged() -> None:
    estimate = estimator()
    update(estimate, 0, 0.0)
    assert update(estimate, 100_000_000, 0.2)[0] == pytest.approx(2.0)


@pytest.mark.parametrize("bad", [[math.nan, 0.0], [math.inf, 0.0]])
def test_positions_that_cannot_be_used_are_refused_and_leave_no_trace(bad: list[float]) -> None:
    estimate = estimator(n_joints=2)
    for k in range(10):
        update(estimate, k * 2_000_000, 0.002 * k, 0.0)
    with pytest.raises(StateError, match="expected finite numbers"):
        update(estimate, 20_000_000, *bad)
    assert update(estimate, 22_000_000, 0.022, 0.0) == pytest.approx([1.0, 0.0])


def test_an_estimate_that_was_handed_out_does_not_change_any_more() -> None:
    estimate = estimator()
    position = np.array([0.0])
    estimate.fill(0, position, np.full(1, np.nan))
    first = update(estimate, 2_000_000, 0.002)
    position[0] = 9.0
    update(estimate, 4_000_000, 0.1)
    assert first[0] == pytest.approx(1.0)


NAN = math.nan


def fill(missing: MissingVelocities, k: int, velocity: list[float]) -> list[float]:
    """Hand in the state of tick k of an arm whose joints all move at 1 rad/s; return the velocities."""
    time_ns = k * 2_000_000
    return missing.fill(time_ns, np.full(len(velocity), 1e-9 * time_ns), np.array(velocity)).tolist()


def test_reported_velocities_are_passed_on_and_missing_ones_estimated() -> None:
    missing = estimator(n_joints=3)
    assert fill(missing, 0, [0.9, NAN, NAN]) == [0.9, 0.0, 0.0]
    assert fill(missing, 1, [0.8, NAN, NAN]) == pytest.approx([0.8, 1.0, 1.0])
    assert missing.estimated == (1, 2)


def test_an_arm_that_reports_all_velocities_is_left_alone() -> None:
    missing = estimator(n_joints=2)
    velocity = np.array([0.1, 0.2])
    assert missing.fill(0, np.array([0.0, 0.0]), velocity) is velocity
    assert missing.estimated == ()


def test_a_velocity_that_is_nan_after_it_has_been_reported_once_is_not_made_up() -> None:
    missing = estimator(n_joints=2)
    fill(missing, 0, [0.5, NAN])
    assert fill(missing, 1, [NAN, NAN]) == pytest.approx([NAN, 1.0], nan_ok=True)
    assert fill(missing, 2, [0.5, 0.6]) == [0.5, 0.6]
    assert fill(missing, 3, [NAN, NAN]) == pytest.approx([NAN, NAN], nan_ok=True)
    assert missing.estimated == ()


def test_an_infinite_velocity_is_a_fault_and_not_a_missing_one() -> None:
    missing = estimator(n_joints=2)
    fill(missing, 0, [NAN, NAN])
    assert fill(missing, 1, [math.inf, NAN]) == pytest.approx([math.inf, 1.0])


def test_joints_that_begin_to_report_are_not_estimated_any_more() -> None:
    missing = estimator(n_joints=2)
    fill(missing, 0, [NAN, NAN])
    assert missing.estimated == (0, 1)
    assert fill(missing, 1, [0.7, NAN]) == pytest.approx([0.7, 1.0])
    assert missing.estimated == (1,)
