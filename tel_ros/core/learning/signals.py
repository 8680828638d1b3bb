"""From what was recorded in a trial to what the network learns from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import butter, sosfiltfilt

from tel_ros.core.errors import TrainingError
from tel_ros.core.learning.inputs import stack_inputs
from tel_ros.core.types import NS_PER_S, BoolArray, FloatArray, IntArray

_FILTER_ORDER = 4
_SHORTEST_RECORD = 50


@dataclass(frozen=True)
class TrialSignals:
    """One trial as recorded, tick by tick, from the time before RUN to the end.

    Args:
        time_ns: stamps. Shape (n,).
        run: which ticks belong to RUN. Shape (n,).
        desired: y as positions, velocities, accelerations at the ticks. Shape (n, 3 * n_joints).
        position_rad: ŷ as measured. Shape (n, n_joints).
        equilibrium_rad: û as sent. Shape (n, n_joints).
    """

    time_ns: IntArray
    run: BoolArray
    desired: FloatArray
    position_rad: FloatArray
    equilibrium_rad: FloatArray


@dataclass(frozen=True)
class TrainingSamples:
    """Pairs to learn from.

    Args:
        actual: ŷ as inputs of the network. Shape (n, 3 * n_joints).
        desired: y at the same moments. Shape (n, 3 * n_joints).
        offset_rad: û - q̂, what N(ŷ) should have been. Shape (n, n_joints).
    """

    actual: FloatArray
    desired: FloatArray
    offset_rad: FloatArray


def training_samples(trial: TrialSignals, cutoff_hz: float) -> TrainingSamples:
    """Filter and differentiate a recorded trial.

    Positions and commands go through the same zero-phase low-pass (Butterworth of order 4, forwards and
    backwards), so that no lag between them is learned. It runs over the whole record and only then RUN is cut
    out, so that its beginning and end are not the filter's. Velocities are central differences. The command
    of tick k acts from tick k to k + 1: it is paired with the position and velocity at k and with the mean
    acceleration of that interval.

    Args:
        trial: the record.
        cutoff_hz: -3 dB of one pass; 0 or anything from half of the sampling rate up switches the filter off.

    Raises:
        TrainingError: fewer than 50 ticks of RUN, or a value that is not finite.
    """
    n_run = int(np.count_nonzero(trial.run))
    if n_run < _SHORTEST_RECORD:
        raise TrainingError(f"the trial has {n_run} ticks of RUN; expected at least {_SHORTEST_RECORD}")
    for name in ("desired", "position_rad", "equilibrium_rad"):
        if not np.all(np.isfinite(getattr(trial, name))):
            raise TrainingError(f"{name} of the trial has values that are not finite")
    period_s = float(np.median(np.diff(trial.time_ns))) / NS_PER_S
    time_s = np.arange(round((trial.time_ns[-1] - trial.time_ns[0]) / NS_PER_S / period_s) + 1) * period_s
    record_s = (trial.time_ns - trial.time_ns[0]) / NS_PER_S

    def smooth(values: FloatArray) -> FloatArray:
        even = np.column_stack([np.interp(time_s, record_s, column) for column in values.T])
        if 0.0 < cutoff_hz < 0.5 / period_s:
            sos = butter(_FILTER_ORDER, cutoff_hz, fs=1.0 / period_s, output="sos")
            even = sosfiltfilt(sos, even, axis=0)
        return even

    position = smooth(trial.position_rad)
    velocity = np.gradient(position, period_s, axis=0)
    acceleration = np.diff(velocity, axis=0, append=velocity[-1:]) / period_s
    offset = smooth(trial.equilibrium_rad) - position
    actual = stack_inputs(position, velocity, acceleration)

    # Back from the even grid to the ticks that were recorded in RUN.
    rows = np.clip(np.round(record_s[trial.run] / period_s).astype(np.int64), 0, len(time_s) - 1)
    desired = trial.desired[trial.run].copy()
    desired_acceleration = desired[:, -position.shape[1] :]
    desired_acceleration[:-1] = 0.5 * (desired_acceleration[:-1] + desired_acceleration[1:])
    return TrainingSamples(actual=actual[rows], desired=desired, offset_rad=offset[rows])
