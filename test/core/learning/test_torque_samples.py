"""From a recording to samples of motion and torque, and how well the motion excites the dynamics."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from made_up_recording import JOINTS, made_up, torque_nm

from tel_ros.core.learning.inputs import input_name
from tel_ros.core.learning.noise import low_pass
from tel_ros.core.learning.torque_samples import (
    TorqueSamples,
    condition_number,
    excitation,
    motion,
    motion_noise,
    recorded_range,
    torque_samples,
)


@pytest.mark.parametrize("rate_hz", [30.0, 125.0, 1000.0])
def test_accelerations_are_right_within_a_few_per_cent(rate_hz: float) -> None:
    made = made_up(12.0, rate_hz)
    (samples,) = torque_samples(made.recording)
    truth = made.truth(samples.time_s)
    error = np.sqrt(np.mean((samples.inputs - truth) ** 2, axis=0)) / truth.std(axis=0)
    assert np.all(error < [0.001, 0.001, 0.005, 0.005, 0.05, 0.05])


@pytest.mark.parametrize("rate_hz", [30.0, 125.0])
def test_torque_is_not_shifted_against_the_motion(rate_hz: float) -> None:
    """A lag of half a sample at 30 Hz would leave an error of 6 % of the torque."""
    made = made_up(12.0, rate_hz, noise_nm=0.0, noise_rad=0.0)
    (samples,) = torque_samples(made.recording)
    expected = torque_nm(samples.inputs)
    assert np.sqrt(np.mean((samples.torque_nm - expected) ** 2)) < 0.02 * expected.std()


def test_a_cutoff_that_is_asked_for_is_used() -> None:
    recording = made_up(8.0, 200.0).recording
    (samples,) = torque_samples(recording, cutoff_hz=6.0)
    (unfiltered,) = torque_samples(recording, cutoff_hz=0.0)
    assert samples.bandwidth_hz == 6.0
    assert unfiltered.bandwidth_hz == pytest.approx(100.0, rel=0.05)
    assert unfiltered.input_noise[4] > 20.0 * samples.input_noise[4]


def test_a_rate_is_reached_by_leaving_samples_out() -> None:
    recording = made_up(8.0, 200.0, jitter=0.0).recording
    (all_of_them,) = torque_samples(recording)
    (some,) = torque_samples(recording, most_hz=60.0)
    assert some.period_s == pytest.approx(4.0 / 200.0)
    np.testing.assert_allclose(np.diff(some.time_s), some.period_s)
    np.testing.assert_array_equal(some.inputs, all_of_them.inputs[::4])
    (as_recorded,) = torque_samples(recording, most_hz=200.0)
    assert len(as_recorded) == len(all_of_them)


def test_parts_that_are_too_short_are_left_out() -> None:
    recording = made_up(10.0, 100.0).recording
    gap = (recording.time_s > 0.2) & (recording.time_s < 0.5)
    (samples,) = torque_samples(recording[~gap])
    assert samples.time_s[0] > 0.5


def test_noise_of_the_motion_is_what_the_formula_says() -> None:
    rng, period_s, cutoff_hz = np.random.default_rng(3), 0.008, 10.0
    noise = rng.normal(size=(20_000, 1))
    time_s = period_s * np.arange(len(noise))
    measured = motion(time_s, low_pass(noise, cutoff_hz, period_s))[100:-100].std(axis=0)
    # Most of the acceleration lies within 3 Hz below the cutoff: in 160 s that is as much as 1,000
    # independent samples, whose standard deviation has a standard error of 2 %.
    np.testing.assert_allclose(motion_noise(cutoff_hz, period_s), measured, rtol=0.06)


def test_the_range_of_velocities_goes_both_ways() -> None:
    samples = torque_samples(made_up(6.0).recording)
    inputs = np.vstack([part.inputs for part in samples])
    found = recorded_range(samples)
    np.testing.assert_allclose(found.low[:2], inputs[:, :2].min(axis=0))
    np.testing.assert_allclose(found.high[2:], np.abs(inputs[:, 2:]).max(axis=0))
    np.testing.assert_allclose(found.low[2:], -found.high[2:])


@pytest.fixture(scope="module")
def samples() -> TorqueSamples:
    """A rich movement."""
    return torque_samples(made_up(20.0, 100.0).recording)[0]


def sine(samples: TorqueSamples, omega: float, amplitude: float = 0.5) -> np.ndarray:
    t = samples.time_s[:, None]
    return amplitude * np.hstack(
        [np.sin(omega * t), omega * np.cos(omega * t), -(omega**2) * np.sin(omega * t)]
    )


def test_a_rich_movement_gives_no_warning(samples: TorqueSamples) -> None:
    found = excitation(JOINTS, [samples])
    assert found.warnings() == []
    assert found.joints[0].position_rad[0] == pytest.approx(samples.inputs[:, 0].min())
    assert found.joints[1].velocity_rad_s == pytest.approx(np.abs(samples.inputs[:, 3]).max())


def test_a_single_sine_cannot_tell_inertia_from_position(samples: TorqueSamples) -> None:
    inputs = samples.inputs.copy()
    inputs[:, 1::2] = sine(samples, 3.0)
    (warning,) = excitation(JOINTS, [replace(samples, inputs=inputs)]).warnings()[:1]
    assert "elbow go together" in warning
    assert "several frequencies" in warning


def test_joints_that_move_together_are_noticed(samples: TorqueSamples) -> None:
    inputs = samples.inputs.copy()
    inputs[:, 1::2] = 0.5 * inputs[:, 0::2] + 1e-4 * inputs[:, 1::2]
    (warning,) = excitation(JOINTS, [replace(samples, inputs=inputs)]).warnings()
    assert "the joints move together" in warning


def test_a_joint_that_hardly_moves_is_named(samples: TorqueSamples) -> None:
    inputs = samples.inputs.copy()
    inputs[:, 0::2] *= 0.02
    (warning,) = excitation(JOINTS, [replace(samples, inputs=inputs)]).warnings()
    assert warning.startswith("shoulder moved within 0.0")


def test_accelerations_that_drown_in_noise_are_named(samples: TorqueSamples) -> None:
    noise = samples.input_noise.copy()
    noise[5] = samples.inputs[:, 5].std()
    (warning,) = excitation(JOINTS, [replace(samples, input_noise=noise)]).warnings()
    assert "accelerations of elbow are 1 times their noise" in warning


def test_condition_numbers() -> None:
    rng = np.random.default_rng(1)
    independent = rng.normal(size=(20_000, 2))
    assert condition_number(independent) == pytest.approx(1.0, abs=0.03)
    # Correlation r: the singular values are √(1 + r) and √(1 - r).
    together = independent @ np.linalg.cholesky([[1.0, 0.6], [0.6, 1.0]]).T
    assert condition_number(together * [1.0, 1e6]) == pytest.approx(2.0, rel=0.03)
    assert condition_number(np.ones((10, 2))) == np.inf


def test_inputs_have_names() -> None:
    assert [input_name(JOINTS, k) for k in (0, 3, 4)] == [
        "shoulder position",
        "elbow velocity",
        "shoulder acceleration",
    ]
