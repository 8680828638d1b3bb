"""What was recorded of an arm's joints, whatever recorded it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from tel_ros.core.errors import InputFileError
from tel_ros.core.types import BoolArray, FloatArray

_FEWEST = 50
_STANDS_STILL = 1e-6
"""Range in rad within which a joint has not moved at all."""


@dataclass(frozen=True)
class JointRecording:
    """Positions and efforts of joints over time, sampled as it happened.

    Args:
        source: file and topic, for messages.
        joints: names, in the order of the columns.
        time_s: since the first sample. Shape (n,).
        position_rad: shape (n, n_joints).
        effort_nm: NaN where the source tells none. Shape (n, n_joints).
    """

    source: str
    joints: tuple[str, ...]
    time_s: FloatArray
    position_rad: FloatArray
    effort_nm: FloatArray

    @property
    def duration_s(self) -> float:
        """From the first sample to the last."""
        return float(self.time_s[-1] - self.time_s[0]) if len(self.time_s) else 0.0

    def __getitem__(self, rows: slice | BoolArray) -> Self:
        """Return some of the samples."""
        return replace(
            self,
            time_s=self.time_s[rows],
            position_rad=self.position_rad[rows],
            effort_nm=self.effort_nm[rows],
        )

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
        return replace(
            self,
            joints=tuple(joints),
            position_rad=self.position_rad[:, columns],
            effort_nm=self.effort_nm[:, columns],
        )

    def ranges_rad(self) -> dict[str, tuple[float, float]]:
        """Return the lowest and the highest position of each joint."""
        low, high = self.position_rad.min(axis=0).tolist(), self.position_rad.max(axis=0).tolist()
        return dict(zip(self.joints, zip(low, high, strict=True), strict=True))

    def with_effort(self) -> tuple[str, ...]:
        """Return the joints whose effort is told throughout."""
        return tuple(
            j for j, effort in zip(self.joints, self.effort_nm.T, strict=True) if np.isfinite(effort).all()
        )

    def require_learnable(self) -> None:
        """Refuse what torque cannot be learned from.

        Raises:
            InputFileError: too few samples, stamps that go back, values that are not finite, no effort, an
                effort or a position that never changes.
        """
        if len(self.time_s) < _FEWEST:
            raise self._refused(f"holds {len(self.time_s)} samples", f"at least {_FEWEST}")
        back = np.flatnonzero(np.diff(self.time_s) < 0.0)
        if len(back):
            k = int(back[0]) + 1
            raise self._refused(
                f"the stamp of sample {k + 1} is {self.time_s[k - 1] - self.time_s[k]:.6g} s before the one "
                f"of sample {k} ({len(back)} such places)",
                "stamps in the order of time: cut the recording there, or sort it if it was only mixed up",
            )
        for joint, position, effort in zip(self.joints, self.position_rad.T, self.effort_nm.T, strict=True):
            leave_out = "leave the joint out with --joints"
            if not np.isfinite(position).all():
                raise self._refused(f"{joint} has positions that are not finite", f"numbers, or {leave_out}")
            if not np.isfinite(effort).all():
                raise self._refused(f"tells no effort for {joint}", f"efforts in N·m, or {leave_out}")
            if np.ptp(effort) == 0.0:
                found = f"the effort of {joint} is {effort[0]:g} N·m throughout"
                raise self._refused(found, f"an effort that is measured, or {leave_out}")
            if np.ptp(position) <= _STANDS_STILL:
                found = f"{joint} stands still at {position[0]:.6g} rad throughout"
                raise self._refused(found, f"a joint that moves, or {leave_out}")

    def _refused(self, found: str, expected: str) -> InputFileError:
        return InputFileError(self.source, found, expected)
