"""Encoders, noise and the estimated velocity."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from sim_bridge.arm import SimulatedArm
from sim_bridge.sensors import JointSensors
from tel_ros.core.config import SimConfig

MakeArm = Callable[..., SimulatedArm]

PERIOD_S = 0.002


def sensors(n_joints: int = 1, **sim: float) -> JointSensors:
    """Make the sensors of a joint; exact unless asked otherwise."""
    exact = SimConfig(encoder_bits=0, position_noise_rad=0.0, velocity_filter_hz=0.0)
    return JointSensors(n_joints, replace(exact, **sim), period_s=PERIOD_S, seed=1)


def test_exact_sensors_report_the_true_state(make_arm: MakeArm) -> None:
    arm = make_arm(encoder_bits=0, position_noise_rad=0.0, velocity_filter_hz=20.0)
    for _ in range(50):
        arm.step([4.0, -2.0])
        assert arm.reading().position_rad == arm.true_position_rad
        assert arm.reading().velocity_rad_s == arm.true_velocity_rad_s


@pytest.mark.parametrize("bits", [8, 12, 16])
def test_an_encoder_reports_the_nearest_of_its_steps(make_arm: MakeArm, bits: int) -> None:
    arm = make_arm(encoder_bits=bits)
    step_rad = 2.0 * math.pi / 2**bits
    for _ in range(200):
        arm.step([1.0, -0.5])
        measured, true = np.array(arm.reading().position_rad), np.array(arm.true_position_rad)
        # A multiple is right to its last binary digit; half a step is a matter of the true angle's last one.
        assert np.allclose(measured / step_rad, np.round(measured / step_rad), rtol=1e-12, atol=0.0)
        assert np.all(np.abs(measured - true) <= 0.5 * step_rad * (1.0 + 1e-9))


def test_noise_is_white_with_the_configured_deviation() -> None:
    noisy = sensors(position_noise_rad=0.01)
    readings = []
    for _ in range(20_000):
        noisy.update([0.5], [0.0])
        readings.append(noisy.position_rad[0] - 0.5)
    # Five standard errors of each estimate from 20,000 samples.
    assert np.std(readings) == pytest.approx(0.01, rel=5 / math.sqrt(2 * 20_000))
    assert np.mean(readings) == pytest.approx(0.0, abs=0.01 * 5 / math.sqrt(20_000))
    assert np.corrcoef(readings[1:], readings[:-1])[0, 1] == pytest.approx(0.0, abs=5 / math.sqrt(20_000))


def test_noise_is_added_before_the_encoder_rounds() -> None:
    noisy = sensors(position_noise_rad=0.01, encoder_bits=8)
    for _ in range(100):
        noisy.update([0.5], [0.0])
        steps = noisy.position_rad[0] / (2.0 * math.pi / 2**8)
        assert steps == pytest.approx(round(steps), rel=1e-12)


def test_equal_seeds_give_equal_noise_and_others_do_not(make_arm: MakeArm) -> None:
    first, same, other = (make_arm(position_noise_rad=1e-3, seed=seed) for seed in (4, 4, 5))
    for arm in (first, same, other):
        arm.step([1.0, 1.0])
    assert first.reading() == same.reading()
    assert first.reading().position_rad != other.reading().position_rad
    assert first.true_position_rad == other.true_position_rad


def test_joints_have_noise_of_their_own() -> None:
    pair = sensors(2, position_noise_rad=0.01)
    pair.update([0.0, 0.0], [0.0, 0.0])
    assert pair.position_rad[0] != pair.position_rad[1]


def test_without_a_filter_velocity_is_the_difference_of_successive_readings(make_arm: MakeArm) -> None:
    arm = make_arm(encoder_bits=12, velocity_filter_hz=0.0)
    for _ in range(100):
        before = np.array(arm.reading().position_rad)
        arm.step([5.0, -3.0])
        now = arm.reading()
        assert np.allclose(
            now.velocity_rad_s, (np.array(now.position_rad) - before) / PERIOD_S, rtol=0.0, atol=1e-12
        )


def test_the_velocity_filter_is_a_first_order_low_pass() -> None:
    """A sudden speed of 1 rad/s is seen as 1 - exp(-2π f t), to within the encoder's step over a period."""
    filtered = sensors(encoder_bits=32, velocity_filter_hz=20.0)
    filtered.start([0.0], [0.0])
    for n in range(1, 60):
        filtered.update([n * PERIOD_S], [1.0])
        expected = 1.0 - math.exp(-2.0 * math.pi * 20.0 * n * PERIOD_S)
        assert filtered.velocity_rad_s[0] == pytest.approx(expected, abs=2e-6)


def test_an_arm_that_starts_away_from_zero_does_not_seem_to_have_jumped_there(make_arm: MakeArm) -> None:
    arm = make_arm(initial_position_rad=(1.0, 2.0), velocity_filter_hz=0.0)
    assert arm.reading().velocity_rad_s == (0.0, 0.0)
    arm.step([0.0, 0.0])
    assert arm.reading().velocity_rad_s == (0.0, 0.0)
