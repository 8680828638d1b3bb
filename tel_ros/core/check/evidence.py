"""The evidence that checks judge (joint states, pulses), and their findings."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields
from enum import Enum
from functools import cached_property

import numpy as np

from tel_ros.core.config import ArmConfig
from tel_ros.core.types import NS_PER_S, FloatArray, IntArray

ROUNDING_RAD = 1e-6
"""By so much equal readings or steps may differ: four roundings in single precision of up to 4 rad."""
DEGREES = math.degrees(1.0)
ENOUGH_STATES = 20

Endpoint = tuple[str, str, str]
"""Node, type and reliability of a publisher or subscription."""


@dataclass(frozen=True)
class StateRecord:
    """Joint states in the order of their arrival: n rows, a column a joint; NaN where nothing was sent."""

    joints: tuple[str, ...]
    received_s: FloatArray
    """On a clock that only runs forward."""
    stamp_ns: IntArray
    age_s: FloatArray
    """The time of day at arrival minus the stamp."""
    position_rad: FloatArray
    velocity_rad_s: FloatArray
    effort_nm: FloatArray

    def __len__(self) -> int:
        """Return the number of states."""
        return len(self.received_s)

    def between(self, start_s: float, end_s: float) -> StateRecord:
        """Return the states that arrived from ``start_s`` until ``end_s``."""
        rows = (self.received_s >= start_s) & (self.received_s <= end_s)
        return StateRecord(self.joints, *(getattr(self, column.name)[rows] for column in fields(self)[1:]))

    def resolution_rad(self) -> FloatArray:
        """Return the resolution of the positions of an arm at rest or in motion. Shape (n_joints,).

        The smallest step that was seen, which is that of the encoder, or the noise from one state to the
        next, whichever is more. Zero for a joint that has not changed.
        """
        steps = np.diff(self.position_rad, axis=0)
        # Of a joint that moves a step is motion, but how steps differ is not; and steps of an encoder differ
        # by steps of the encoder.
        changes = np.diff(steps, axis=0)
        both = np.abs(np.concatenate([steps, changes]))
        both[both < ROUNDING_RAD] = 0.0
        smallest: FloatArray = np.where(both > 0.0, both, np.inf).min(axis=0, initial=np.inf)
        smallest[~np.isfinite(smallest)] = 0.0
        if not len(changes):
            return smallest
        # The variance of the difference of two neighbouring steps is three times that of a step.
        noise: FloatArray = np.median(both[len(steps) :], axis=0) / math.sqrt(3.0)
        return np.maximum(smallest, noise)


@dataclass(frozen=True)
class Pulse:
    """Torque on a joint (a number) one way and then the other way, as it was sent, on our clock.

    ``effort_nm`` from ``start_s``, its opposite from ``turn_s``, zero from ``zero_s``. At ``end_s`` the arm
    had been left alone for a moment, not yet braked. ``states`` begin a moment before ``start_s``.
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
    """A constant torque from ``start_s`` to ``silent_s``, the last command, and then none until ``end_s``."""

    joint: int
    effort_nm: float
    start_s: float
    silent_s: float
    end_s: float
    states: StateRecord


@dataclass(frozen=True)
class Pulsed:
    """What a session of pulses has shown."""

    pulses: Sequence[Pulse]
    """The strongest pair of each joint."""
    silence: Silence | None
    """The test of the watchdog, if there was one."""
    visible_rad: FloatArray
    """How far each joint has to go to have moved at all. Shape (n_joints,)."""
    complaint: str
    """Why it ended early; empty if it did not."""
    mend: str
    inertia_kgm2: FloatArray | None
    """Of the URDF at this posture, shape (n_joints, n_joints); None: not known."""
    friction_nms_per_rad: FloatArray
    """Viscous, of the URDF. Shape (n_joints,)."""

    def of(self, joint: int) -> list[Pulse]:
        """Return the pulses of one joint."""
        return [pulse for pulse in self.pulses if pulse.joint == joint]

    @cached_property
    def moved(self) -> list[int]:
        """Joints whose pulses have moved something."""
        moved = [p for p in self.pulses if np.any(np.abs(p.displacement_rad()) >= self.visible_rad)]
        return sorted({pulse.joint for pulse in moved})


@dataclass(frozen=True)
class Evidence:
    """All that is known of an arm that is checked."""

    arm: ArmConfig
    rate_hz: float
    """As configured."""
    states: StateRecord
    """Heard while nobody commanded."""
    publishers: Sequence[Endpoint] = ()
    """Of joint states."""
    commanders: Sequence[Endpoint] = ()
    """Publishers of commands, without the check's own."""
    listeners: Sequence[Endpoint] = ()
    """Subscriptions of commands."""
    names: Iterable[tuple[str, ...]] = ()
    """Lists of names that have come; each message has one."""
    malformed: int = 0
    """Messages whose fields do not fit together."""
    listened_s: float = 0.0
    arm_has_own_clock: bool = False
    """Stamps count the arm's own time (as a simulated arm's do) and show no age."""
    not_pulsed: str = ""
    """Why no pulses were sent, if they were not."""
    moving: StateRecord | None = None
    """Everything that was heard since, while the arm was pulsed or moved by hand."""
    pulses: Pulsed | None = None

    @property
    def pulsed(self) -> Pulsed:
        """What pulses have shown, for checks that need it."""
        assert self.pulses is not None
        return self.pulses

    @property
    def moved(self) -> StateRecord:
        """States of an arm that moved, for checks that need them."""
        assert self.moving is not None
        return self.moving


class Verdict(Enum):
    """How one check ended."""

    OK = "ok"
    WARNING = "warning"
    """It does not forbid to go on, but somebody should know."""
    NOT_CHECKED = "not checked"
    WRONG = "wrong"


@dataclass(frozen=True)
class Finding:
    """One line of the table: what was measured and expected, in words with units, and what to do about it."""

    verdict: Verdict
    measured: str
    expected: str
    mend: str = ""
    joint: str = ""
    """Empty: the arm as a whole."""
    blocks: bool = False
    """Whether the arm must not be moved before this is mended."""
    check: str = ""
    """Title of the check, which fills it in."""


def unchecked(measured: str, expected: str, mend: str = "", joint: str = "") -> Finding:
    """Return a finding of what could not be checked."""
    return Finding(Verdict.NOT_CHECKED, measured, expected, mend, joint)


def judged(
    good: bool,
    measured: str,
    expected: str,
    mend: str,
    *,
    joint: str = "",
    otherwise: Verdict = Verdict.WRONG,
    blocks: bool = False,
) -> Finding:
    """Return a finding that is OK, or ``otherwise`` with what to mend."""
    if good:
        return Finding(Verdict.OK, measured, expected, "", joint)
    return Finding(otherwise, measured, expected, mend, joint, blocks and otherwise is Verdict.WRONG)
