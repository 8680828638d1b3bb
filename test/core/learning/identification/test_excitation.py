"""Movements that tell too little are called so."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from made_up_recording import JOINTS, made_up

from tel_ros.core.learning.inputs import input_name
from tel_ros.core.learning.torque_samples import TorqueSamples, condition_number, excitation, torque_samples


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
