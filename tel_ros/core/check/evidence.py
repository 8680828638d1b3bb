"""The evidence that checks judge (joint states, pulses), and their findings."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields
from enum import Enum
from functools import cached_property
from typing import NamedTuple

import numpy as np

from tel_ros.core.config import ArmConfig
from tel_ros.core.types import NS_PER_S, FloatArray, IntArray

ROUNDING_RAD = 1e-6
"""By so much equal readings or steps may differ: four roundings in single precision of up to 4 rad."""
DEGREES = math.degrees(1.0)
ENOUGH_STATES = 20
_FIRST_SHARE = 0.4

Endpoint = tuple[str, str, str]
"""Node, type and reliability of a publisher or subscription."""


class Heard(NamedTuple):
    """One joint state; a value a joint, NaN where nothing was sent."""

    received_s: float
    """On a clock that only runs forward."""
    stamp_ns: int
    age_s: float
    """The time of day at arrival minus the stamp."""
    position_rad: FloatArray
    velocity_rad_s: FloatArray
    effort_nm: FloatArray


@dataclass(frozen=True)
class StateRecord:
    """Joint states in the order of their arrival: the fields of :class:`Heard`, n rows, a column a joint."""

    joints: tuple[str, ...]
    received_s: FloatArray
    stamp_ns: IntArray
    age_s: FloatArray
    position_rad: FloatArray
    velocity_rad_s: FloatArray
    effort_nm: FloatArray

    @classmethod
    def of(cls, joints: tuple[str, ...], rows: Sequence[Heard]) -> StateRecord:
        """Return the record of these states."""
        times = (
            np.array([row[k] for row in rows], dtype=kind) for k, kind in enumerate((float, np.int64, float))
        )
        shape = (len(rows), len(joints))
        values = (np.array([row[k] for row in rows], dtype=float).reshape(shape) for k in (3, 4, 5))
        return cls(joints, *times, *values)

    def __len__(self) -> int:
        """Return the number of states."""
        return len(self.received_s)

    def between(self, start_s: float, end_s: float) -> StateRecord:
        """Return the states that arrived from ``start_s`` until ``end_s``."""
        rows = (self.received_s >= start_s) & (self.received_s <= end_s)
        return StateRecord(self.joints, *(getattr(self, column.name)[rows] for column in fields(self)[1:]))

    @cached_property
    def longest_still_s(self) -> float:
        """For how long no position or velocity has changed, at most; infinite if none ever has."""
        values = np.nan_to_num(np.hstack([self.position_rad, self.velocity_rad_s]))
        changed = np.flatnonzero(np.any(np.diff(values, axis=0) != 0.0, axis=1)) + 1
        return float(np.diff(self.received_s[[0, *changed, -1]]).max()) if len(changed) else math.inf

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

    @cached_property
    def stood_still(self) -> bool:
        """Whether no position or velocity has changed since it began."""
        return len(self.states) > 1 and math.isinf(self.states.longest_still_s)

    def arm_time_factor(self) -> float:
        """Return how fast the arm's time runs by ours: below 1 for a simulated arm on a busy machine."""
        received_s, stamp_ns = self.states.received_s, self.states.stamp_ns
        if len(received_s) < 2 or received_s[-1] <= received_s[0] or stamp_ns[-1] <= stamp_ns[0]:
            return 1.0
        return float((stamp_ns[-1] - stamp_ns[0]) / NS_PER_S / (received_s[-1] - received_s[0]))

    @cached_property
    def reach_rad(self) -> FloatArray:
        """How far each joint got from where it was, the way it went first. Shape (n_joints,).

        Where it is at the end tells less: dry friction, cogging and springs take a joint back.
        """
        position = self.states.position_rad
        before = self.states.received_s <= self.start_s
        away = position - (position[before].mean(axis=0) if np.any(before) else position[0])
        smooth = (away[:-2] + away[1:-1] + away[2:]) / 3.0 if len(away) > 2 else away
        first = np.argmax(np.abs(smooth) >= _FIRST_SHARE * np.abs(smooth).max(axis=0), axis=0)
        way = np.sign(smooth[first, np.arange(smooth.shape[1])])
        return np.asarray(way * (way * smooth).max(axis=0), dtype=np.float64)

    @cached_property
    def effort_gain(self) -> float:
        """The slope of the joint's effort field on its command; NaN where no effort is sent.

        Both halves are compared, so that a constant offset (gravity, a sensor's bias) drops out. The field
        may be late by a quarter of a half.
        """
        first_s, second_s = self.turn_s - self.start_s, self.zero_s - self.turn_s
        first = self.states.between(self.start_s + 0.4 * first_s, self.turn_s + 0.1 * first_s)
        second = self.states.between(self.turn_s + 0.4 * second_s, self.zero_s + 0.1 * second_s)
        if not len(first) or not len(second):
            return math.nan
        halves = (np.median(half.effort_nm[:, self.joint]) for half in (first, second))
        return float(-np.diff(list(halves))[0]) / (2.0 * self.effort_nm)


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
class UrdfModel:
    """What the URDF says of the arm at this posture."""

    inertia_kgm2: FloatArray | None
    """Shape (n_joints, n_joints)."""
    friction_nms_per_rad: FloatArray
    """Viscous. Shape (n_joints,)."""
    missing: str = ""
    """Why the inertia is not known, if it is not."""


@dataclass(frozen=True)
class Pulsed:
    """What a session of pulses has shown."""

    pulses: Sequence[Pulse]
    """The strongest pair of each joint."""
    silence: Silence | None
    """The test of the watchdog, if there was one."""
    resolution_rad: FloatArray
    """Of the positions. Shape (n_joints,)."""
    noticed_rad: FloatArray
    """How far each joint has to go for something to be there at all. Shape (n_joints,)."""
    visible_rad: FloatArray
    """How far it has to go to be judged by it. Shape (n_joints,)."""
    complaint: str
    """Why it ended early; empty if it did not."""
    mend: str
    model: UrdfModel

    def of(self, joint: int) -> list[Pulse]:
        """Return the pulses of one joint."""
        return [pulse for pulse in self.pulses if pulse.joint == joint]

    def effort_gain(self, joint: int) -> float:
        """Return the slope of the effort field of a joint on its command; NaN if it is not known."""
        gains = [pulse.effort_gain for pulse in self.of(joint) if not math.isnan(pulse.effort_gain)]
        return float(np.median(gains)) if gains else math.nan

    @cached_property
    def moved(self) -> list[int]:
        """Joints whose pulses have moved something."""
        moved = [p for p in self.pulses if np.any(np.abs(p.reach_rad) >= self.visible_rad)]
        return sorted({pulse.joint for pulse in moved})


_NONE = np.zeros(0)
NOT_PULSED = Pulsed((), None, _NONE, _NONE, _NONE, "", "", UrdfModel(None, _NONE))


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
    moving: StateRecord = StateRecord.of((), ())
    """Everything that was heard since, while the arm was pulsed or moved by hand."""
    pulsed: Pulsed = NOT_PULSED


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
    check: str = ""
    joint: str = ""
    """Empty: the arm as a whole. The check fills in its title, the joint and whether it blocks."""
    blocks: bool = False
    """Whether the arm must not be moved before this is mended."""


def unchecked(reason: str, expected: str, mend: str = "") -> Finding:
    """Return a finding of what could not be checked, for this reason."""
    return Finding(Verdict.NOT_CHECKED, f"because {reason}", expected, mend)


def judged(
    good: bool, measured: str, expected: str, mend: str, otherwise: Verdict = Verdict.WRONG
) -> Finding:
    """Return a finding that is OK, or ``otherwise`` with what to mend."""
    return Finding(Verdict.OK, measured, expected) if good else Finding(otherwise, measured, expected, mend)
