"""From what was recorded in a trial to what the network learns from."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
import scipy  # loads its parts when they are first used: half a second that most processes do without

from tel_ros.core.config import LearningConfig
from tel_ros.core.errors import TrainingError, counted
from tel_ros.core.learning.inputs import stack_inputs
from tel_ros.core.learning.noise import (
    choose_cutoff_hz,
    derivative_noise,
    derivatives,
    filters,
    low_pass,
    sensor_noise,
    slides_throughout,
)
from tel_ros.core.trial import Phase, Trial
from tel_ros.core.types import NS_PER_S, BoolArray, FloatArray, IntArray

_SHORTEST_RECORD = 50
_LONGEST_STEP_NS = NS_PER_S
"""Stamps further apart belong to different courses of time."""
_MEMORY_PERIODS = 0.5
"""How far on either side the filter spreads what happens at one tick, in periods of its cutoff."""
_STEP_PERIODS = 1.0
"""The same of a step, which is what dry friction makes at a reversal: after half a period up to 7 % of it are
left, from here on at most 2 %."""


@dataclass(frozen=True)
class TrialSignals:
    """What is learned from of a :class:`~tel_ros.core.trial.Trial`, from the time before RUN to the end.

    Shapes as there. ``run`` tells the ticks of RUN; û did not act where it is ``saturated``.
    """

    time_ns: IntArray
    run: BoolArray
    desired: FloatArray
    position_rad: FloatArray
    equilibrium_rad: FloatArray
    saturated: BoolArray


def learning_record(trial: Trial) -> TrialSignals:
    """Return what the network learns from: the ticks from the start posture on.

    A stop is not RUN, but belongs to the record: one that breaks off in mid-motion would leave the transient
    of the filter in RUN. So would the step from û to the command of the brake: û stays at its last value, as
    in HOLD. A stop after a jump of the stamps is left out.
    """
    time_ns, phase = trial.time_ns, trial.phase
    rows = np.isin(phase, (Phase.SETTLE, Phase.RUN, Phase.HOLD))
    equilibrium_rad = trial.equilibrium_rad.copy()
    if trial.springs is not None:
        equilibrium_rad = trial.springs.learned(equilibrium_rad, trial.position_rad, trial.velocity_rad_s)
    if rows.any():
        last = int(np.flatnonzero(rows)[-1])
        step_ns = np.diff(time_ns[last:])
        follows = np.logical_and.accumulate((step_ns > 0) & (step_ns <= _LONGEST_STEP_NS))
        rows[last + 1 :] = follows & (phase[last + 1 :] == Phase.STOP)
        equilibrium_rad[last + 1 :] = equilibrium_rad[last]
    measured, clipped = trial.position_rad[rows], trial.saturated[rows]
    desired, equilibrium_rad = trial.desired[rows], equilibrium_rad[rows]
    return TrialSignals(time_ns[rows], trial.run[rows], desired, measured, equilibrium_rad, clipped)


@dataclass(frozen=True)
class TrainingSamples:
    """Pairs to learn from: ŷ and y as inputs of the network (n, 3 * n_joints), offsets (n, n_joints)."""

    actual: FloatArray
    desired: FloatArray
    offset_rad: FloatArray
    """û - q̂, what N(ŷ) should have been."""
    input_noise: FloatArray = field(default_factory=lambda: np.empty(0))
    """Standard deviation of the noise left in each column of ``actual``; empty if not known."""
    period_s: float = 0.0
    """From sample to sample, where none is left out; 0 if not known."""
    bandwidth_hz: float = math.inf
    """Above it is nothing: the filter's, or half of the sampling rate; inf if not known."""
    sliding: BoolArray = field(default_factory=lambda: np.empty((0, 0), dtype=bool))
    """Whether each joint moves in one direction in all that a sample is made of, so that dry friction has one
    sign there. Shape (n, n_joints); empty if not known."""

    @property
    def certain(self) -> BoolArray:
        """Where each joint slides; everywhere if that is not known. Shape (n, n_joints)."""
        return self.sliding if self.sliding.size else np.ones(self.offset_rad.shape, dtype=bool)


def configured_samples(trial: TrialSignals, learning: LearningConfig) -> TrainingSamples:
    """Filter and differentiate a recorded trial as a configuration asks for; see :func:`training_samples`."""
    cutoff_hz = learning.filter_cutoff_hz
    if learning.filter == "fixed":
        return training_samples(trial, cutoff_hz)
    return training_samples(trial, None, most_hz=cutoff_hz or math.inf)


def training_samples(
    trial: TrialSignals, cutoff_hz: float | None, *, most_hz: float = math.inf
) -> TrainingSamples:
    """Filter and differentiate a recorded trial.

    Positions and commands go through the same zero-phase low-pass, so that no lag between them is learned.
    It runs over the whole record and only then RUN is cut out, so that the filter's transients stay outside.
    The command of tick k acts from tick k to k + 1: it is paired with the position and velocity at k and with
    the mean acceleration of that interval.

    Where the effort of any joint was clipped, the command did not act. Those ticks are left out, and so are
    the neighbours that filter and differences mix with them: half a period of the cutoff on either side, at
    least one tick.

    The cutoff is that of :func:`~.noise.low_pass`; None: chosen from the positions of this trial's RUN, see
    :func:`~.noise.choose_cutoff_hz`, up to ``most_hz``. What a joint does at higher frequencies (stick-slip,
    say) can be far above its noise and still say nothing about inertia.

    Raises:
        TrainingError: fewer than 50 ticks of RUN are left, or a value is not finite.
    """
    n_run = int(np.count_nonzero(trial.run))
    if n_run < _SHORTEST_RECORD:
        found = counted(n_run, "tick")
        raise TrainingError(f"the trial has {found} of RUN; expected at least {_SHORTEST_RECORD}")
    for name in ("desired", "position_rad", "equilibrium_rad"):
        if not np.all(np.isfinite(getattr(trial, name))):
            raise TrainingError(f"{name} of the trial has values that are not finite")
    period_s = float(np.median(np.diff(trial.time_ns))) / NS_PER_S
    time_s = np.arange(round((trial.time_ns[-1] - trial.time_ns[0]) / NS_PER_S / period_s) + 1) * period_s
    record_s = (trial.time_ns - trial.time_ns[0]) / NS_PER_S

    def even(values: FloatArray) -> FloatArray:
        return np.column_stack([np.interp(time_s, record_s, column) for column in values.T])

    # Back from the even grid to the ticks that were recorded in RUN.
    rows = np.clip(np.round(record_s[trial.run] / period_s).astype(np.int64), 0, len(time_s) - 1)
    measured = even(trial.position_rad)
    # The noise is measured in RUN alone: at rest an encoder's hides in one step.
    moving = measured[rows[0] : rows[-1] + 1]
    if cutoff_hz is None:
        cutoff_hz = min(choose_cutoff_hz(moving, period_s), most_hz)
    kept = _untouched_by_saturation(trial, _reach(_MEMORY_PERIODS, cutoff_hz, period_s))

    position = low_pass(measured, cutoff_hz, period_s)
    velocity, acceleration = derivatives(position, period_s)
    offset = low_pass(even(_acting_equilibrium(trial)), cutoff_hz, period_s) - position
    actual = stack_inputs(position, velocity, acceleration)
    noise = derivative_noise(cutoff_hz, period_s)[:, None] * sensor_noise(moving, period_s)
    sliding = slides_throughout(velocity, noise[1], _reach(_STEP_PERIODS, cutoff_hz, period_s))

    desired = trial.desired[trial.run].copy()
    desired_acceleration = desired[:, -position.shape[1] :]
    desired_acceleration[:-1] = 0.5 * (desired_acceleration[:-1] + desired_acceleration[1:])
    return TrainingSamples(
        actual=actual[rows[kept]],
        desired=desired[kept],
        offset_rad=offset[rows[kept]],
        input_noise=noise.ravel(),
        period_s=period_s,
        bandwidth_hz=cutoff_hz if filters(cutoff_hz, period_s) else 0.5 / period_s,
        sliding=sliding[rows[kept]],
    )


def _reach(periods: float, cutoff_hz: float, period_s: float) -> int:
    """Return so many periods of the cutoff as ticks; at least the one that differences mix in."""
    memory_s = periods / cutoff_hz if filters(cutoff_hz, period_s) else 0.0
    return max(1, math.ceil(memory_s / period_s))


def _untouched_by_saturation(trial: TrialSignals, reach: int) -> BoolArray:
    """Return which ticks of RUN to keep, at least 50. Shape (number of ticks of RUN,)."""
    clipped: BoolArray = np.any(trial.saturated, axis=1)
    touched = scipy.ndimage.maximum_filter1d(clipped.astype(np.uint8), 2 * reach + 1, mode="constant") > 0
    kept: BoolArray = ~touched[trial.run]
    n_kept, n_clipped = np.count_nonzero(kept), np.count_nonzero(clipped & trial.run)
    if n_kept < _SHORTEST_RECORD:
        raise TrainingError(
            f"the effort was clipped, or held back for states that came late, in {n_clipped} of the "
            f"{counted(len(kept), 'tick')} of RUN, which leaves {n_kept} to learn from; expected at least "
            f"{_SHORTEST_RECORD}. Move slower, or raise the effort limit; against late states: "
            "docs/realtime.md."
        )
    return kept


def _acting_equilibrium(trial: TrialSignals) -> FloatArray:
    """Return û, with an estimate of what acted in place of commands that were clipped. Shape (n, n_joints).

    The filter would carry the command that did not act far into the ticks on either side. At both ends of a
    clipped stretch the limit just allows û - q, so between them a straight line is near to what acted.
    """
    offset = trial.equilibrium_rad - trial.position_rad
    for column, clipped in zip(offset.T, trial.saturated.T, strict=True):
        if clipped.any() and not clipped.all():
            ticks = np.arange(len(clipped))
            column[clipped] = np.interp(ticks[clipped], ticks[~clipped], column[~clipped])
    return np.where(trial.saturated, trial.position_rad + offset, trial.equilibrium_rad)
