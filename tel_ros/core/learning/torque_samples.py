"""From a recording to what a learner of torque is taught, and how well the arm was excited in it.

Positions and efforts go through the same zero-phase Butterworth filter (see :mod:`.noise`), so that the
torque that is learned belongs to the motion that is left; a Savitzky-Golay filter smooths a position and its
derivatives differently. Behind the filter the derivatives may be those of an interpolating spline: at 30 Hz,
accelerations of a motion of up to 3 Hz are wrong by 0.7 % instead of the 7 % of central differences
(docs/imported-bags.md).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from scipy.interpolate import make_interp_spline

from tel_ros.core.learning.inputs import InputRange, stack_inputs
from tel_ros.core.learning.joint_recording import JointRecording
from tel_ros.core.learning.noise import (
    choose_cutoff_hz,
    filtered_impulse,
    filters,
    low_pass,
    sensor_noise,
    slides_throughout,
)
from tel_ros.core.learning.signals import TrainingSamples
from tel_ros.core.types import BoolArray, FloatArray

HIGHEST_CUTOFF_HZ = 15.0
"""To choose: what drives and gears do above that does not depend on the links."""
_IF_NO_NOISE_SHOWS = 0.25
"""Of the sampling rate: the cutoff of a slow recording in which motion and noise cannot be separated."""
_SHORTEST_PART = 50
_SPLINE_DEGREE = 5
FEWEST_OF_SPLINE = _SPLINE_DEGREE + 1
_SPLINE_EDGE = 6
"""Samples from either end in which the derivatives of the spline are not those of the motion."""
MOST_CONDITION_OF_JOINT = 10.0
"""Where two of three standardised signals have a correlation of 0.98: with noise, their parts in a torque
cannot be separated."""
MOST_CONDITION_OF_ARM = 100.0
"""A usual limit for a movement that is to identify an arm (Gautier and Khalil, 1992)."""
LEAST_RANGE_RAD = 0.1
LEAST_ACCELERATION_SNR = 3.0


@dataclass(frozen=True)
class TorqueSamples:
    """Motion and torque in one unbroken stretch of time, evenly sampled.

    ``inputs`` are q, q̇, q̈ in rad, rad/s, rad/s² of shape (n, 3 * n_joints); the last four are as in
    :class:`~.signals.TrainingSamples`.
    """

    source: str
    time_s: FloatArray
    inputs: FloatArray
    torque_nm: FloatArray
    period_s: float
    bandwidth_hz: float
    input_noise: FloatArray
    sliding: BoolArray

    def __len__(self) -> int:
        """Return the number of samples."""
        return len(self.time_s)

    def __getitem__(self, rows: slice | BoolArray) -> Self:
        """Return some of the samples."""
        columns = {name: getattr(self, name)[rows] for name in ("time_s", "inputs", "torque_nm", "sliding")}
        return replace(self, **columns)

    def to_learn(self, unit_nm: FloatArray) -> TrainingSamples:
        """Return them for a learner whose outputs are torques in units of ``unit_nm``, shape (n_joints,)."""
        known = (self.input_noise, self.period_s, self.bandwidth_hz, self.sliding)
        return TrainingSamples(self.inputs, self.inputs, self.torque_nm / unit_nm, *known)


def torque_samples(
    recording: JointRecording, *, cutoff_hz: float | None = None, most_hz: float = math.inf
) -> list[TorqueSamples]:
    """Resample, filter and differentiate a recording, each unbroken part by itself.

    It has passed :meth:`~.joint_recording.JointRecording.require_learnable`. The cutoff is -3 dB of one pass;
    0: no filter; None: :func:`chosen_cutoff_hz` of each part. The rate of what is returned, at most
    ``most_hz``, is the recording's divided by a whole number. Parts that are too short are left out, and so
    are the ends of the others, in which the filter rings.
    """
    found = []
    for part in recording.unbroken():
        period_s = part.median_period_s
        if period_s == 0.0 or part.duration_s < _SHORTEST_PART * period_s:
            continue
        even = part.evenly_sampled(period_s)
        cutoff = chosen_cutoff_hz(even[1], period_s) if cutoff_hz is None else cutoff_hz
        samples = _filtered(part.source, *even, cutoff)
        if len(samples):
            step = max(1, math.ceil(1.0 / (period_s * most_hz) - 1e-6))
            found.append(replace(samples[::step], period_s=step * period_s))
    return found


def chosen_cutoff_hz(position_rad: FloatArray, period_s: float) -> float:
    """Return the cutoff that suits evenly sampled positions (see :func:`~.noise.choose_cutoff_hz`).

    It is at most 15 Hz, and never none: without a filter, a spline makes accelerations of the noise at half
    of the sampling rate.
    """
    chosen_hz = choose_cutoff_hz(position_rad, period_s)
    return min(chosen_hz or _IF_NO_NOISE_SHOWS / period_s, HIGHEST_CUTOFF_HZ)


def motion(time_s: FloatArray, position_rad: FloatArray) -> FloatArray:
    """Return positions, velocities and accelerations of at least 6 positions, by quintic splines.

    Shapes (n,), (n, n_joints), (n, 3 * n_joints).
    """
    spline = make_interp_spline(time_s, position_rad, k=_SPLINE_DEGREE)
    return stack_inputs(position_rad, spline(time_s, 1), spline(time_s, 2))


def motion_noise(cutoff_hz: float, period_s: float) -> FloatArray:
    """Return what white noise of unit standard deviation on positions becomes in q, q̇, q̈. Shape (3,)."""
    position = filtered_impulse(cutoff_hz, period_s)
    time_s: FloatArray = period_s * np.arange(len(position), dtype=np.float64)
    return np.sqrt(np.sum(motion(time_s, position) ** 2, axis=0))


def recorded_range(samples: Iterable[TorqueSamples]) -> InputRange:
    """Return the range of each input in some samples: nothing outside has been seen.

    Velocities and accelerations are symmetric about zero, because a movement can be run backwards.
    """
    inputs = np.vstack([part.inputs for part in samples])
    n_joints = inputs.shape[1] // 3
    low, high = inputs.min(axis=0), inputs.max(axis=0)
    high[n_joints:] = np.maximum(np.abs(low[n_joints:]), np.abs(high[n_joints:]))
    low[n_joints:] = -high[n_joints:]
    width = np.maximum(high - low, 1e-6)
    middle = 0.5 * (low + high)
    return InputRange(middle - 0.5 * width, middle + 0.5 * width)


def _filtered(
    source: str, time_s: FloatArray, measured_rad: FloatArray, effort_nm: FloatArray, cutoff_hz: float
) -> TorqueSamples:
    period_s = float(time_s[1] - time_s[0])
    inputs = motion(time_s, low_pass(measured_rad, cutoff_hz, period_s))
    noise = motion_noise(cutoff_hz, period_s)[:, None] * sensor_noise(measured_rad, period_s)
    # A step, which is what dry friction makes, is all but through the filter after a period of its cutoff.
    is_filtered = filters(cutoff_hz, period_s)
    reach = max(1, math.ceil(1.0 / (cutoff_hz * period_s))) if is_filtered else 1
    n_joints = measured_rad.shape[1]
    sliding = slides_throughout(inputs[:, n_joints : 2 * n_joints], noise[1], reach)
    torque_nm = low_pass(effort_nm, cutoff_hz, period_s)
    bandwidth_hz = cutoff_hz if is_filtered else 0.5 / period_s
    even = (time_s, inputs, torque_nm, period_s, bandwidth_hz, noise.ravel(), sliding)
    whole = TorqueSamples(source, *even)
    edge = max(reach, _SPLINE_EDGE)
    return whole[edge : len(time_s) - edge]


@dataclass(frozen=True)
class JointExcitation:
    """How a joint moved."""

    joint: str
    position_rad: tuple[float, float]
    """Lowest and highest."""
    velocity_rad_s: float
    """Highest absolute value, as of the acceleration."""
    acceleration_rad_s2: float
    condition: float
    """Condition number of the joint's own standardised q, q̇, q̈."""
    acceleration_snr: float
    """RMS acceleration over that of its noise."""

    def warnings(self) -> list[str]:
        """Return what is poor about it, in words, each with what to do."""
        found, (low, high) = [], self.position_rad
        if high - low < LEAST_RANGE_RAD:
            found.append(
                f"{self.joint} moved within {high - low:.3g} rad only (expected at least "
                f"{LEAST_RANGE_RAD:g}): what depends on its position is not learned"
            )
        if self.condition > MOST_CONDITION_OF_JOINT:
            found.append(
                f"position, velocity and acceleration of {self.joint} go together (condition "
                f"{self.condition:.3g}, expected at most {MOST_CONDITION_OF_JOINT:g}): inertia cannot be "
                "separated from what depends on position. Move it at several frequencies"
            )
        if self.acceleration_snr < LEAST_ACCELERATION_SNR:
            found.append(
                f"the accelerations of {self.joint} are {self.acceleration_snr:.2g} times their noise "
                f"(expected at least {LEAST_ACCELERATION_SNR:g}): move faster, or lower --cutoff-hz"
            )
        return found


@dataclass(frozen=True)
class Excitation:
    """How an arm moved: joint by joint, and the condition number of q, q̇, q̈ of all joints together."""

    joints: tuple[JointExcitation, ...]
    condition: float

    def warnings(self) -> list[str]:
        """Return what is poor about it, in words, each with what to do."""
        found = [warning for joint in self.joints for warning in joint.warnings()]
        if self.condition > MOST_CONDITION_OF_ARM:
            found.append(
                f"the joints move together (condition {self.condition:.3g}, expected at most "
                f"{MOST_CONDITION_OF_ARM:g}): which inertia makes a torque cannot be separated. Move them on "
                "paths that differ"
            )
        return found


def excitation(joints: Sequence[str], parts: Sequence[TorqueSamples]) -> Excitation:
    """Return how well the recorded motion excites the dynamics."""
    inputs = np.vstack([part.inputs for part in parts])
    noise = np.sqrt(np.average([p.input_noise**2 for p in parts], axis=0, weights=[len(p) for p in parts]))
    n_joints = len(joints)
    found = []
    for j, joint in enumerate(joints):
        own = inputs[:, j::n_joints]
        snr = np.sqrt(np.mean(own[:, 2] ** 2)) / max(float(noise[2 * n_joints + j]), 1e-300)
        speed_rad_s, acceleration_rad_s2 = np.abs(own[:, 1:]).max(axis=0).tolist()
        reach_rad = (float(own[:, 0].min()), float(own[:, 0].max()))
        most = (reach_rad, speed_rad_s, acceleration_rad_s2)
        found.append(JointExcitation(joint, *most, condition_number(own), float(snr)))
    return Excitation(tuple(found), condition_number(inputs))


def condition_number(columns: FloatArray) -> float:
    """Return the ratio of the largest to the smallest singular value of standardised columns, or inf."""
    centred = columns - columns.mean(axis=0)
    spread = centred.std(axis=0)
    if not np.all(spread > 0.0):
        return float("inf")
    values = np.linalg.eigvalsh((centred / spread).T @ (centred / spread))
    return float(np.sqrt(values[-1] / values[0])) if values[0] > 0.0 else float("inf")
