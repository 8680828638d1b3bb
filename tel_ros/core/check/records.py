"""What the judgements are made from: states as they arrived, and pulses as they were sent."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tel_ros.core.types import NS_PER_S, FloatArray, IntArray

ROUNDING_RAD = 1e-6
"""What the driver's own arithmetic, single precision as well, makes of equal readings, or of equal steps.

Four roundings of angles up to 4 rad at most; and far less than a pulse is to be seen by.
"""


@dataclass(frozen=True)
class StateRecord:
    """Joint states in the order of their arrival.

    Args:
        joints: names, in the order of all columns.
        received_s: when they arrived, on a clock that only runs forward. Shape (n,).
        stamp_ns: as they were stamped. Shape (n,).
        age_s: the time of day at arrival minus the stamp. Shape (n,).
        position_rad: shape (n, n_joints).
        velocity_rad_s: NaN where none was sent. Shape (n, n_joints).
        effort_nm: NaN where none was sent. Shape (n, n_joints).
    """

    joints: tuple[str, ...]
    received_s: FloatArray
    stamp_ns: IntArray
    age_s: FloatArray
    position_rad: FloatArray
    velocity_rad_s: FloatArray
    effort_nm: FloatArray

    def __len__(self) -> int:
        """Return the number of states."""
        return len(self.received_s)

    def between(self, start_s: float, end_s: float) -> StateRecord:
        """Return the states that arrived from ``start_s`` until ``end_s``."""
        rows = (self.received_s >= start_s) & (self.received_s <= end_s)
        return StateRecord(
            self.joints,
            self.received_s[rows],
            self.stamp_ns[rows],
            self.age_s[rows],
            self.position_rad[rows],
            self.velocity_rad_s[rows],
            self.effort_nm[rows],
        )

    def resolution_rad(self) -> FloatArray:
        """Return what positions cannot tell apart, from states of an arm at rest or in motion.

        The smallest step that was seen, which is that of the encoder, or the noise from one state to the
        next, whichever is more. Zero for a joint that has not changed. Shape (n_joints,).
        """
        steps = np.diff(self.position_rad, axis=0)
        # Of a joint that moves a step is motion, but how steps differ is not; and steps of an encoder differ
        # by steps of the encoder.
        changes = np.diff(steps, axis=0)
        both = np.abs(np.concatenate([steps, changes]))
        both[both < ROUNDING_RAD] = 0.0
        smallest = np.where(both > 0.0, both, np.inf).min(axis=0, initial=np.inf)
        smallest[~np.isfinite(smallest)] = 0.0
        if not len(changes):
            return np.asarray(smallest, dtype=np.float64)
        # The variance of the difference of two neighbouring steps is three times that of a step.
        noise = np.median(both[len(steps) :], axis=0) / math.sqrt(3.0)
        return np.asarray(np.maximum(smallest, noise), dtype=np.float64)


@dataclass(frozen=True)
class Pulse:
    """A torque one way and then the other way for as long, as it was sent, on the clock of ``received_s``.

    Args:
        joint: which one, as a number.
        effort_nm: of the first half, signed.
        start_s: first command of the first half.
        turn_s: first command of the second half.
        zero_s: first command of zero effort after it.
        end_s: when the arm had been left alone for a moment, before anything braked it.
        states: from a moment before ``start_s`` until ``end_s``.
    """

    joint: int
    effort_nm: float
    start_s: float
    turn_s: float
    zero_s: float
    end_s: float
    states: StateRecord

    def arm_time_factor(self) -> float:
        """Return how fast the arm's time runs by ours: below 1 for a simulated arm on a busy machine."""
        received_s, stamp_ns = self.states.received_s, self.states.stamp_ns
        if len(received_s) < 2 or received_s[-1] <= received_s[0] or stamp_ns[-1] <= stamp_ns[0]:
            return 1.0
        return float((stamp_ns[-1] - stamp_ns[0]) / NS_PER_S / (received_s[-1] - received_s[0]))

    def displacement_rad(self) -> FloatArray:
        """Return how far each joint is from where it was. Shape (n_joints,)."""
        before = self.states.received_s <= self.start_s
        position = self.states.position_rad
        start = position[before].mean(axis=0) if np.any(before) else position[0]
        return np.asarray(position[-3:].mean(axis=0) - start, dtype=np.float64)


@dataclass(frozen=True)
class Silence:
    """A constant torque, and then no command at all.

    Args:
        joint: which one, as a number.
        effort_nm: that was commanded last.
        start_s: first command.
        silent_s: last command.
        end_s: the end of the silence: zero effort was commanded then.
        states: from ``start_s`` until ``end_s``.
    """

    joint: int
    effort_nm: float
    start_s: float
    silent_s: float
    end_s: float
    states: StateRecord
