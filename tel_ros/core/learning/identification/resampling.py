"""From samples at uneven times to even ones."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.interpolate import CubicSpline

from tel_ros.core.learning.identification.joint_recording import JointRecording
from tel_ros.core.types import FloatArray

_LONGEST_GAP_S = 0.025
"""What happens in that time at up to 10 Hz is still told by the samples around it."""
_LONGEST_GAP = 2.5
"""The same in periods, for slow recordings: one lost sample."""
_TOO_CLOSE = 0.25
"""Of a period: two samples that close say the same, and noise would make a spline through both steep."""


def median_period_s(recording: JointRecording) -> float:
    """Return the usual time from one sample to the next that has another stamp."""
    step_s = np.diff(recording.time_s)
    return float(np.median(step_s[step_s > 0.0])) if np.any(step_s > 0.0) else 0.0


def unbroken(recording: JointRecording) -> Iterator[JointRecording]:
    """Yield the parts of a recording between gaps that are too long to look across.

    A part has stamps that increase and are at least a quarter of a period apart: closer samples are replaced
    by their mean.
    """
    period_s = median_period_s(recording)
    if period_s == 0.0:
        return
    gaps = np.flatnonzero(np.diff(recording.time_s) > max(_LONGEST_GAP * period_s, _LONGEST_GAP_S)) + 1
    for first, end in zip([0, *gaps], [*gaps, len(recording.time_s)], strict=True):
        yield _thinned(recording[int(first) : int(end)], _TOO_CLOSE * period_s)


def evenly_sampled(recording: JointRecording, period_s: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return time [s], positions [rad] and efforts [N·m] on an even grid, by cubic splines.

    Linear interpolation would add up to T² q̈ / 8 to a position, which at 30 Hz is more than an encoder's
    noise; a cubic spline adds a term of T⁴.

    Args:
        recording: one unbroken part.
        period_s: of the grid.

    Returns:
        Shapes (n,), (n, n_joints), (n, n_joints).
    """
    start_s = float(recording.time_s[0])
    n = int(recording.duration_s / period_s * (1.0 + 1e-9)) + 1
    time_s: FloatArray = start_s + period_s * np.arange(n, dtype=np.float64)
    values = np.hstack([recording.position_rad, recording.effort_nm])
    even: FloatArray = CubicSpline(recording.time_s, values)(time_s)
    n_joints = len(recording.joints)
    return time_s, even[:, :n_joints], even[:, n_joints:]


def _thinned(part: JointRecording, least_s: float) -> JointRecording:
    """Return a part in which samples less than ``least_s`` behind the first of a group are their mean."""
    group = np.zeros(len(part.time_s), dtype=np.int64)
    if np.all(np.diff(part.time_s) >= least_s):
        return part
    start_s, number = float(part.time_s[0]), 0
    for k, time_s in enumerate(part.time_s.tolist()):
        if time_s - start_s >= least_s:
            start_s, number = time_s, number + 1
        group[k] = number
    count = np.bincount(group)

    def mean(values: FloatArray) -> FloatArray:
        return np.column_stack([np.bincount(group, column) / count for column in values.T])

    return JointRecording(
        part.source,
        part.joints,
        mean(part.time_s[:, None])[:, 0],
        mean(part.position_rad),
        mean(part.effort_nm),
    )
