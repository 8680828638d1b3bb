"""What the encoders of the simulated arm report, and the velocity that a drive makes of it."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from tel_ros.core.config import JointValues, SimConfig


class JointSensors:
    """Encoders with seeded white noise, and the velocity estimate of a simple drive.

    A position reading is the true angle plus noise, rounded to the nearest encoder step of 2π / 2^bits. A
    velocity reading is the difference of two successive position readings over the time between them, through
    a first-order low-pass: it is late by half a period plus the filter's time constant 1 / (2π f), and as
    coarse as the encoder makes it. With exact encoders and no noise there is nothing to estimate: the true
    velocity is read, without filter. ``sim``: bits of the encoder, standard deviation of the noise on each
    position reading, and corner frequency f of the low-pass; each 0: none. ``period_s``: time between
    readings. ``seed``: of the noise.
    """

    def __init__(self, n_joints: int, sim: SimConfig, *, period_s: float, seed: int) -> None:
        self._n_joints = n_joints
        self._period_s = period_s
        self._step_rad = 2.0 * math.pi / 2**sim.encoder_bits if sim.encoder_bits else 0.0
        self._noise_rad = sim.position_noise_rad
        self._exact = sim.encoder_bits == 0 and sim.position_noise_rad == 0.0
        # The share of the newest difference in the estimate: the first-order low-pass solved exactly for an
        # input that is constant over a period, so that it is stable for every corner frequency.
        cutoff_hz = sim.velocity_filter_hz or math.inf
        self._newest_share = 1.0 - math.exp(-2.0 * math.pi * cutoff_hz * period_s)
        self._rng = np.random.default_rng(seed)
        self.position_rad: JointValues = (0.0,) * n_joints
        self.velocity_rad_s: JointValues = (0.0,) * n_joints
        """Of the last reading."""

    def start(self, position_rad: Sequence[float], velocity_rad_s: Sequence[float]) -> None:
        """Begin anew with a moving arm; otherwise its first position would look like a very fast movement."""
        self.position_rad = self._measured_position(position_rad)
        self.velocity_rad_s = tuple(velocity_rad_s)

    def update(self, position_rad: Sequence[float], velocity_rad_s: Sequence[float]) -> None:
        """Take the next reading of an arm with this true state. To be called once a period."""
        measured_rad = self._measured_position(position_rad)
        if self._exact:
            self.velocity_rad_s = tuple(velocity_rad_s)
        else:
            share, period_s = self._newest_share, self._period_s
            readings = zip(self.velocity_rad_s, measured_rad, self.position_rad, strict=True)
            self.velocity_rad_s = tuple(
                [old + share * ((now - before) / period_s - old) for old, now, before in readings]
            )
        self.position_rad = measured_rad

    def _measured_position(self, position_rad: Sequence[float]) -> JointValues:
        values = position_rad
        if self._noise_rad:
            noise_rad = self._rng.normal(0.0, self._noise_rad, self._n_joints).tolist()
            values = [value + error for value, error in zip(values, noise_rad, strict=True)]
        if self._step_rad:
            step_rad = self._step_rad
            values = [round(value / step_rad) * step_rad for value in values]
        return tuple(values)
