"""From an even recording to what a learner of torque is taught.

Positions and efforts go through the same zero-phase Butterworth filter (see :mod:`..noise`), so that the
torque that is learned belongs to the motion that is left. A Savitzky-Golay filter smooths a position, its
first and its second derivative differently, and the effort again differently: what M(q) q̈ loses at the upper
end of the motion, the torque keeps. The filter leaves next to nothing above its cutoff, so the derivatives
after it may be those of an interpolating spline: at 30 Hz, accelerations of a motion of up to 3 Hz are wrong
by 0.7 % instead of the 7 % of central differences (docs/imported-bags.md).
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from scipy.interpolate import make_interp_spline

from tel_ros.core.learning.identification.joint_recording import JointRecording
from tel_ros.core.learning.identification.resampling import evenly_sampled, median_period_s, unbroken
from tel_ros.core.learning.inputs import InputRange, stack_inputs
from tel_ros.core.learning.noise import choose_cutoff_hz, filters, low_pass, sensor_noise
from tel_ros.core.learning.signals import TrainingSamples
from tel_ros.core.learning.sliding import slides_throughout
from tel_ros.core.types import BoolArray, FloatArray

HIGHEST_CUTOFF_HZ = 15.0
"""To choose: what drives and gears do above that tells nothing about the links."""
_IF_NO_NOISE_SHOWS = 0.25
"""Of the sampling rate: the cutoff of a slow recording in which motion and noise cannot be told apart."""
_SHORTEST_PART = 50
_SPLINE_DEGREE = 5
FEWEST_OF_SPLINE = _SPLINE_DEGREE + 1
_SPLINE_EDGE = 6
"""Samples from either end in which the derivatives of the spline are not those of the motion."""
_NARROWEST = 1e-6


@dataclass(frozen=True)
class TorqueSamples:
    """Motion and torque in one unbroken stretch of time, evenly sampled.

    Args:
        source: where it is from, for messages.
        time_s: shape (n,).
        inputs: q, q̇, q̈ in rad, rad/s, rad/s². Shape (n, 3 * n_joints).
        torque_nm: shape (n, n_joints).
        period_s: from sample to sample.
        bandwidth_hz: what lies above has been filtered away.
        input_noise: standard deviation of what is left of the noise in each input. Shape (3 * n_joints,).
        sliding: see :class:`~..signals.TrainingSamples`. Shape (n, n_joints).
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
        return replace(
            self,
            time_s=self.time_s[rows],
            inputs=self.inputs[rows],
            torque_nm=self.torque_nm[rows],
            sliding=self.sliding[rows],
        )

    def to_learn(self, unit_nm: FloatArray) -> TrainingSamples:
        """Return them for a learner whose outputs are torques in units of ``unit_nm``, shape (n_joints,)."""
        return TrainingSamples(
            actual=self.inputs,
            desired=self.inputs,
            offset_rad=self.torque_nm / unit_nm,
            input_noise=self.input_noise,
            period_s=self.period_s,
            bandwidth_hz=self.bandwidth_hz,
            sliding=self.sliding,
        )


def torque_samples(
    recording: JointRecording, *, cutoff_hz: float | None = None, most_hz: float = math.inf
) -> list[TorqueSamples]:
    """Resample, filter and differentiate a recording, each unbroken part by itself.

    Args:
        recording: which :meth:`~.joint_recording.JointRecording.require_learnable` has let pass.
        cutoff_hz: -3 dB of one pass of the filter; 0: no filter; None: chosen for each part from its
            positions, up to 15 Hz (see :func:`~..noise.choose_cutoff_hz`).
        most_hz: rate of the samples that are returned, at most; it is the recording's divided by a whole
            number.

    Returns:
        One for each part that is long enough; the ends of a part, which are the filter's, are cut off.
    """
    found = []
    for part in unbroken(recording):
        period_s = median_period_s(part)
        if period_s == 0.0 or part.duration_s < _SHORTEST_PART * period_s:
            continue
        time_s, measured, effort_nm = evenly_sampled(part, period_s)
        cutoff = chosen_cutoff_hz(measured, period_s)
        samples = _filtered(
            part.source, time_s, measured, effort_nm, cutoff if cutoff_hz is None else cutoff_hz
        )
        if len(samples):
            step = max(1, math.ceil(1.0 / (period_s * most_hz) - 1e-6))
            found.append(replace(samples[::step], period_s=step * period_s))
    return found


def chosen_cutoff_hz(position_rad: FloatArray, period_s: float) -> float:
    """Return the cutoff that suits evenly sampled positions (see :func:`~..noise.choose_cutoff_hz`).

    It is at most 15 Hz, and there always is one: without, a spline makes accelerations of the noise at half
    of the sampling rate.

    Args:
        position_rad: at least 50 rows. Shape (n, n_joints).
        period_s: from row to row.
    """
    chosen_hz = choose_cutoff_hz(position_rad, period_s)
    return min(chosen_hz or _IF_NO_NOISE_SHOWS / period_s, HIGHEST_CUTOFF_HZ)


def motion(time_s: FloatArray, position_rad: FloatArray) -> FloatArray:
    """Return positions, velocities and accelerations of sampled positions, by quintic splines.

    Args:
        time_s: increasing. Shape (n,), n at least 6.
        position_rad: shape (n, n_joints).

    Returns:
        Shape (n, 3 * n_joints).
    """
    spline = make_interp_spline(time_s, position_rad, k=_SPLINE_DEGREE)
    return stack_inputs(position_rad, spline(time_s, 1), spline(time_s, 2))


def motion_noise(cutoff_hz: float, period_s: float) -> FloatArray:
    """Return what white noise of unit standard deviation on positions becomes in q, q̇, q̈. Shape (3,)."""
    # Of the slowest pole of the filter, exp(-2.4 · 5) = 6e-6 is left after 5 / cutoff.
    memory = math.ceil(5.0 / (cutoff_hz * period_s)) if filters(cutoff_hz, period_s) else 0
    impulse = np.zeros((2 * memory + 51, 1))
    impulse[memory + 25] = 1.0
    time_s: FloatArray = period_s * np.arange(len(impulse), dtype=np.float64)
    response = motion(time_s, low_pass(impulse, cutoff_hz, period_s))
    noise: FloatArray = np.sqrt(np.sum(response**2, axis=0))
    return noise


def recorded_range(samples: Iterable[TorqueSamples]) -> InputRange:
    """Return the range of each input in some samples: nothing outside has been seen.

    Velocities and accelerations are symmetric about zero, because a movement can be run backwards.
    """
    inputs = np.vstack([part.inputs for part in samples])
    n_joints = inputs.shape[1] // 3
    low, high = inputs.min(axis=0), inputs.max(axis=0)
    high[n_joints:] = np.maximum(np.abs(low[n_joints:]), np.abs(high[n_joints:]))
    low[n_joints:] = -high[n_joints:]
    width = np.maximum(high - low, _NARROWEST)
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
    whole = TorqueSamples(
        source=source,
        time_s=time_s,
        inputs=inputs,
        torque_nm=low_pass(effort_nm, cutoff_hz, period_s),
        period_s=period_s,
        bandwidth_hz=cutoff_hz if is_filtered else 0.5 / period_s,
        input_noise=noise.ravel(),
        sliding=slides_throughout(inputs[:, n_joints : 2 * n_joints], noise[1], reach),
    )
    edge = max(reach, _SPLINE_EDGE)
    return whole[edge : len(time_s) - edge]
