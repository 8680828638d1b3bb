"""Which part of a trial the network learns from."""

from __future__ import annotations

import numpy as np

from tel_ros.core.learning.signals import TrialSignals
from tel_ros.core.trial import Phase
from tel_ros.core.types import NS_PER_S, BoolArray, FloatArray, IntArray

_LONGEST_STEP_NS = NS_PER_S
"""Stamps further apart do not belong to one course of time."""


def learning_record(
    *,
    time_ns: IntArray,
    phase: IntArray,
    desired: FloatArray,
    position_rad: FloatArray,
    equilibrium_rad: FloatArray,
    saturated: BoolArray,
) -> TrialSignals:
    """Return what the network learns from: the ticks from the start posture on.

    A stop is not RUN, but belongs to the record: one that breaks off in mid-motion would leave the
    transient of the filter in RUN. So would the step from û to the command of the brake: û stays at its
    last value, as in HOLD. A stop behind a jump of the stamps is left out.

    Args:
        time_ns: stamps of all ticks of a trial. Shape (n,).
        phase: numbers of :class:`Phase`. Shape (n,).
        desired: y as positions, velocities, accelerations. Shape (n, 3 * n_joints).
        position_rad: ŷ as measured. Shape (n, n_joints).
        equilibrium_rad: what the springs pulled towards. Shape (n, n_joints).
        saturated: whether the effort was clipped. Shape (n, n_joints).
    """
    rows = np.isin(phase, (Phase.SETTLE, Phase.RUN, Phase.HOLD))
    equilibrium_rad = equilibrium_rad.copy()
    if rows.any():
        last = int(np.flatnonzero(rows)[-1])
        step_ns = np.diff(time_ns[last:])
        follows = np.logical_and.accumulate((step_ns > 0) & (step_ns <= _LONGEST_STEP_NS))
        rows[last + 1 :] = follows & (phase[last + 1 :] == Phase.STOP)
        equilibrium_rad[last + 1 :] = equilibrium_rad[last]
    return TrialSignals(
        time_ns=time_ns[rows],
        run=phase[rows] == Phase.RUN,
        desired=desired[rows],
        position_rad=position_rad[rows],
        equilibrium_rad=equilibrium_rad[rows],
        saturated=saturated[rows],
    )
