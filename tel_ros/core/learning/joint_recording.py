"""A recording of an arm's joints from any source, and its unbroken parts on an even time grid."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from scipy.interpolate import CubicSpline

from tel_ros.core.errors import InputFileError, counted
from tel_ros.core.types import BoolArray, FloatArray

_FEWEST = 50
_STANDS_STILL = 1e-6
"""Range in rad within which a joint has not moved at all."""
_LONGEST_GAP_S = 0.025
"""Motion at up to 10 Hz can still be interpolated across it."""
_LONGEST_GAP = 2.5
"""The same in periods, for slow recordings: one lost sample."""
_TOO_CLOSE = 0.25
"""Of a period: two samples that close say the same, and noise would make a spline through both steep."""


@dataclass(frozen=True)
class JointRecording:
    """Positions and efforts (n, n_joints) over time (n,), with the time steps of the source."""

    source: str
    """File and topic, for messages."""
    joints: tuple[str, ...]
    time_s: FloatArray
    """Since the first sample."""
    position_rad: FloatArray
    effort_nm: FloatArray
    """NaN where the source has none."""

    @property
    def duration_s(self) -> float:
        """From the first sample to the last."""
        return float(self.time_s[-1] - self.time_s[0]) if len(self.time_s) else 0.0

    @property
    def median_period_s(self) -> float:
        """Usual time from one sample to the next that has another stamp; 0 if there is none."""
        step_s = np.diff(self.time_s)
        return float(np.median(step_s[step_s > 0.0])) if np.any(step_s > 0.0) else 0.0

    def __getitem__(self, rows: slice | BoolArray) -> Self:
        """Return some of the samples."""
        time_s, position_rad, effort_nm = self.time_s[rows], self.position_rad[rows], self.effort_nm[rows]
        return replace(self, time_s=time_s, position_rad=position_rad, effort_nm=effort_nm)

    def of(self, joints: Sequence[str]) -> Self:
        """Return the columns of some joints, in their order.

        Raises:
            InputFileError: a joint was not recorded.
        """
        missing = [joint for joint in joints if joint not in self.joints]
        if missing:
            expected = f"joints among {', '.join(self.joints)}"
            raise InputFileError(self.source, f"has no joint {', '.join(missing)}", expected)
        columns = [self.joints.index(joint) for joint in joints]
        position_rad, effort_nm = self.position_rad[:, columns], self.effort_nm[:, columns]
        return replace(self, joints=tuple(joints), position_rad=position_rad, effort_nm=effort_nm)

    def ranges_rad(self) -> dict[str, tuple[float, float]]:
        """Return the lowest and the highest position of each joint."""
        low, high = self.position_rad.min(axis=0).tolist(), self.position_rad.max(axis=0).tolist()
        return dict(zip(self.joints, zip(low, high, strict=True), strict=True))

    def with_effort(self) -> tuple[str, ...]:
        """Return the joints that have an effort in every sample."""
        return tuple(
            j for j, effort in zip(self.joints, self.effort_nm.T, strict=True) if np.isfinite(effort).all()
        )

    def require_learnable(self) -> None:
        """Raise :class:`InputFileError` for a recording that torque cannot be learned from.

        That is one with too few samples, stamps that go back, values that are not finite, no effort, or an
        effort or a position that never changes.
        """

        def require(good: bool, found: str, expected: str) -> None:
            if not good:
                raise InputFileError(self.source, found, expected)

        n = len(self.time_s)
        require(n >= _FEWEST, f"holds {counted(n, 'sample')}", f"at least {_FEWEST}")
        step_s = np.diff(self.time_s)
        if np.any(step_s < 0.0):
            k = int(np.argmax(step_s < 0.0)) + 1
            raise InputFileError(
                self.source,
                f"the stamp of sample {k + 1} is {-step_s[k - 1]:.6g} s before the one of sample {k} "
                f"({np.count_nonzero(step_s < 0.0)} such places)",
                "stamps in the order of time: cut the recording there, or sort it if it was only mixed up",
            )
        or_without = "or leave the joint out with --joints"
        for joint, position, effort in zip(self.joints, self.position_rad.T, self.effort_nm.T, strict=True):
            finite = bool(np.isfinite(position).all())
            require(finite, f"{joint} has positions that are not finite", f"numbers, {or_without}")
            finite = bool(np.isfinite(effort).all())
            require(finite, f"has no effort for {joint}", f"efforts in N·m, {or_without}")
            found = f"the effort of {joint} is {effort[0]:g} N·m throughout"
            require(np.ptp(effort) != 0.0, found, f"an effort that is measured, {or_without}")
            found = f"{joint} stands still at {position[0]:.6g} rad throughout"
            require(np.ptp(position) > _STANDS_STILL, found, f"a joint that moves, {or_without}")

    def unbroken(self) -> Iterator[Self]:
        """Yield the parts between gaps that are too long to interpolate across.

        The stamps of a part increase and are at least a quarter of a period apart: closer samples are
        replaced by their mean.
        """
        period_s = self.median_period_s
        if period_s == 0.0:
            return
        gaps = np.flatnonzero(np.diff(self.time_s) > max(_LONGEST_GAP * period_s, _LONGEST_GAP_S)) + 1
        for first, end in zip([0, *gaps], [*gaps, len(self.time_s)], strict=True):
            yield self[int(first) : int(end)]._thinned(_TOO_CLOSE * period_s)

    def _thinned(self, least_s: float) -> Self:
        """Return it with samples less than ``least_s`` behind the first of a group replaced by their mean."""
        if np.all(np.diff(self.time_s) >= least_s):
            return self
        group = np.zeros(len(self.time_s), dtype=np.int64)
        start_s, number = float(self.time_s[0]), 0
        for k, time_s in enumerate(self.time_s.tolist()):
            if time_s - start_s >= least_s:
                start_s, number = time_s, number + 1
            group[k] = number
        count = np.bincount(group)

        def mean(values: FloatArray) -> FloatArray:
            return np.column_stack([np.bincount(group, column) / count for column in values.T])

        time_s, position_rad = mean(self.time_s[:, None])[:, 0], mean(self.position_rad)
        return replace(self, time_s=time_s, position_rad=position_rad, effort_nm=mean(self.effort_nm))

    def evenly_sampled(self, period_s: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return time [s], positions [rad] and efforts [N·m] on an even grid, by cubic splines.

        Linear interpolation would add up to T² q̈ / 8 to a position, which at 30 Hz is more than an encoder's
        noise; a cubic spline adds a term of T⁴. It has to be one unbroken part.
        """
        start_s = float(self.time_s[0])
        n = int(self.duration_s / period_s * (1.0 + 1e-9)) + 1
        time_s: FloatArray = start_s + period_s * np.arange(n, dtype=np.float64)
        values = np.hstack([self.position_rad, self.effort_nm])
        position_rad, effort_nm = np.hsplit(CubicSpline(self.time_s, values)(time_s), 2)
        return time_s, position_rad, effort_nm
