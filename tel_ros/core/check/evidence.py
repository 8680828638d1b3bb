"""The evidence that checks judge (joint states, pulses), and their findings."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, fields, replace
from enum import Enum
from functools import cached_property

import numpy as np

from tel_ros.core.config import ArmConfig
from tel_ros.core.types import NS_PER_S, BoolArray, FloatArray, IntArray

ROUNDING_RAD = 1e-6
"""What the driver's own arithmetic, single precision as well, makes of equal readings, or of equal steps.

Four roundings of angles up to 4 rad at most; and far less than the motion by which a pulse is seen.
"""
DEGREES = math.degrees(1.0)
ENOUGH_STATES = 20

Endpoint = tuple[str, str, str]
"""Node, type and reliability of a publisher or subscription."""


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
        return StateRecord(self.joints, *(getattr(self, column.name)[rows] for column in fields(self)[1:]))

    def resolution_rad(self) -> FloatArray:
        """Return the resolution of the positions, from states of an arm at rest or in motion.

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
    """What a session of pulses has shown.

    Args:
        pulses: the strongest pair of each joint.
        silence: the test of the watchdog, if there was one.
        visible_rad: how far each joint has to go to have moved at all. Shape (n_joints,).
        complaint: why it ended early; empty if it did not.
        mend: what to do about that.
        inertia_kgm2: of the URDF at this posture, shape (n_joints, n_joints); None: not known.
        friction_nms_per_rad: viscous, of the URDF. Shape (n_joints,).
    """

    pulses: Sequence[Pulse]
    silence: Silence | None
    visible_rad: FloatArray
    complaint: str
    mend: str
    inertia_kgm2: FloatArray | None
    friction_nms_per_rad: FloatArray

    def of(self, joint: int) -> list[Pulse]:
        """Return the pulses of one joint."""
        return [pulse for pulse in self.pulses if pulse.joint == joint]

    @cached_property
    def moved(self) -> list[int]:
        """Joints whose pulses have moved something."""
        return sorted(
            {p.joint for p in self.pulses if np.any(np.abs(p.displacement_rad()) >= self.visible_rad)}
        )


@dataclass(frozen=True)
class Evidence:
    """All that is known of an arm that is checked.

    Args:
        arm: its limits have been filled.
        rate_hz: configured rate.
        publishers: of joint states.
        commanders: publishers of commands; the check's own is left out.
        listeners: subscriptions of commands.
        names: lists of names that have come; each message has one.
        malformed: number of messages whose fields do not fit together.
        listened_s: for how long.
        states: heard while nobody commanded.
        arm_has_own_clock: stamps count the arm's own time (as a simulated arm's do) and show no age.
        not_pulsed: why no pulses were sent, if they were not.
        moving: everything that was heard since, while the arm was pulsed or moved by hand.
        pulses: what pulses have shown.
    """

    arm: ArmConfig
    rate_hz: float
    states: StateRecord
    publishers: Sequence[Endpoint] = ()
    commanders: Sequence[Endpoint] = ()
    listeners: Sequence[Endpoint] = ()
    names: Iterable[tuple[str, ...]] = ()
    malformed: int = 0
    listened_s: float = 0.0
    arm_has_own_clock: bool = False
    not_pulsed: str = ""
    moving: StateRecord | None = None
    pulses: Pulsed | None = None

    @property
    def pulsed(self) -> Pulsed:
        """What pulses have shown, for checks that need them."""
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
    """One line of the table.

    Args:
        verdict: how the check ended.
        measured: in words, with units.
        expected: in words, with units.
        mend: what to do about it; may be empty.
        joint: which joint; empty: the arm as a whole.
        blocks: whether the arm must not be moved before this is mended.
        check: title of the check, which fills it in.
    """

    verdict: Verdict
    measured: str
    expected: str
    mend: str = ""
    joint: str = ""
    blocks: bool = False
    check: str = ""


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


class Needs(Enum):
    """What has to be there for a check to be made."""

    GRAPH = "who is on the topics, and the names in the joint states"
    STATES = "enough states that name all joints"
    POSITIONS = "such states with finite positions"
    MOTION = "states heard after that, with finite positions"
    ATTEMPT = "an attempt to pulse the arm"
    PULSES = "pulses that were sent"

    def met_by(self, evidence: Evidence) -> bool:
        """Return whether it is there."""
        if self in (Needs.STATES, Needs.POSITIONS):
            enough = len(evidence.states) >= ENOUGH_STATES
            return enough and (self is Needs.STATES or bool(_finite(evidence.states).all()))
        if self is Needs.MOTION:
            return evidence.moving is not None and bool(_finite(evidence.moving).all())
        return self is not Needs.PULSES or evidence.pulses is not None


def _finite(states: StateRecord) -> BoolArray:
    return np.isfinite(states.position_rad)


@dataclass(frozen=True)
class Check:
    """One thing to find out about an arm.

    Args:
        title: as people read it; one check has one title.
        needs: what has to be known for it.
        judge: from the evidence to findings, one for the arm or one for each joint.
    """

    title: str
    needs: Needs
    judge: Callable[[Evidence], Iterable[Finding]]

    def findings(self, evidence: Evidence) -> list[Finding]:
        """Return what it finds, under its title; an empty list if what it needs is missing."""
        found = self.judge(evidence) if self.needs.met_by(evidence) else ()
        return [replace(finding, check=self.title) for finding in found]
