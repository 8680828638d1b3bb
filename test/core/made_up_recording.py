"""What somebody else might have recorded of the two-link arm, and what was true."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from two_link import TwoLinkArm

from tel_ros.core.learning.inputs import stack_inputs
from tel_ros.core.learning.joint_recording import JointRecording
from tel_ros.core.types import FloatArray

JOINTS = ("shoulder", "elbow")
_FREQUENCY_HZ = np.array([[0.11, 0.37, 0.71], [0.13, 0.31, 0.83]])
_AMPLITUDE_RAD = np.array([[0.5, 0.25, 0.1], [0.4, 0.3, 0.12]])
_MIDDLE_RAD = np.array([0.6, 1.2])


@dataclass(frozen=True)
class MadeUp:
    """A recording, and the motion that it is of.

    Args:
        recording: as written down.
        speed: factor on all frequencies.
    """

    recording: JointRecording
    speed: float

    def truth(self, time_s: FloatArray) -> FloatArray:
        """Return q, q̇, q̈ at any time. Shape (n, 6)."""
        return motion_at(time_s, self.speed)


def motion_at(time_s: FloatArray, speed: float = 1.0) -> FloatArray:
    """Return q, q̇, q̈ of sums of three sines. Shape (n, 6)."""
    omega = 2.0 * np.pi * speed * _FREQUENCY_HZ
    angle = omega * time_s[:, None, None] + np.array([[0.3, 1.0, 2.0], [1.5, 0.2, 4.0]])
    return stack_inputs(
        _MIDDLE_RAD + np.sum(_AMPLITUDE_RAD * np.sin(angle), axis=2),
        np.sum(_AMPLITUDE_RAD * omega * np.cos(angle), axis=2),
        np.sum(-_AMPLITUDE_RAD * omega**2 * np.sin(angle), axis=2),
    )


def torque_nm(inputs: FloatArray) -> FloatArray:
    """Return what the motion takes. Shape (n, 2)."""
    return TwoLinkArm(friction_nms_per_rad=0.3).inverse_dynamics(*np.split(inputs, 3, axis=1))


def made_up(
    duration_s: float = 20.0,
    rate_hz: float = 125.0,
    *,
    jitter: float = 0.15,
    noise_rad: float = 3e-5,
    noise_nm: float = 0.02,
    speed: float = 1.0,
) -> MadeUp:
    """Return a recording with uneven stamps and noise, the same one each time.

    Args:
        duration_s: of it.
        rate_hz: mean.
        jitter: standard deviation of a sample's time, in periods.
        noise_rad: on positions.
        noise_nm: on efforts.
        speed: factor on all frequencies.
    """
    rng = np.random.default_rng(7)
    n = round(duration_s * rate_hz)
    time_s = (np.arange(n) + np.clip(rng.normal(0.0, jitter, n), -0.4, 0.4)) / rate_hz
    time_s -= time_s[0]
    inputs = motion_at(time_s, speed)
    recording = JointRecording(
        source="made up",
        joints=JOINTS,
        time_s=time_s,
        position_rad=inputs[:, :2] + noise_rad * rng.normal(size=(n, 2)),
        effort_nm=torque_nm(inputs) + noise_nm * rng.normal(size=(n, 2)),
    )
    return MadeUp(recording, speed)
