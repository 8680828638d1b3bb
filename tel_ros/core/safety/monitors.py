"""What the arm's own reports tell about its sensors, drives and wiring; each monitor ends a trial by name.

Unlike the rules they narrow nothing as long as they find nothing.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from tel_ros.core.arm_state import ArmState
from tel_ros.core.config import ArmConfig, SafetyConfig
from tel_ros.core.safety.motion_rules import largest_inertia, soft_range
from tel_ros.core.types import NS_PER_S, FloatArray


@dataclass(slots=True)
class FrozenJoint:
    """How long the readings of one joint have been the same to the last bit, and what that hides.

    Most of it is noted when they begin to stay the same: a joint in motion has to cost the loop little.
    """

    position: float
    velocity: float
    was_at: float
    """Another position before."""
    stood_for: int = 0
    told_for: int = 0
    """States in which position and velocity have been the same."""
    own_speed: float = 0.0
    """Of the position."""
    step_rad: float = math.inf
    """Smallest change of the position so far: its resolution."""
    changes: int = 0
    """How often the velocity has changed; -1 once it has stayed the same while the joint moved: coarse."""
    position_ns: int = 0
    velocity_ns: int = 0
    position_at: float = 0.0
    """Since when both have been the same; where the joint was when the velocity began to be."""
    moved_rad: float = 0.0
    jitter: float = 0.0
    pulled_s: float = 0.0
    """Since then: the velocity's integral, its noise; how long the effort has been far from what it was."""
    turns: int = 0
    rises: bool = False
    """How often the velocity has turned round since then (a filter's decay never does); where it went."""
    effort_nm: float = 0.0
    pull_nm: float | None = None
    """When it had stood for a few states: what acted, and how hard the spring alone pulled elsewhere."""

    def stand(self, since_ns: int, step_s: float, v: float, before: float) -> None:
        """Take in that the position, but perhaps not the velocity, is the same as at a time before."""
        if not self.stood_for:
            self.position_ns = since_ns
            self.moved_rad = self.jitter = self.pulled_s = 0.0
            self.turns = 0
        if v != before and (v > before) != self.rises:
            self.turns, self.rises = self.turns + 1, v > before
        self.stood_for += 1
        self.moved_rad += v * step_s
        self.jitter += (step_s * (v - before)) ** 2


class FrozenReadings:
    """Notices readings that stand still although their stamps go on.

    A damper that answers a speed that is not there does not damp, and springs whose joint does not seem to
    move pull without end. So position and velocity are held against each other, joint by joint, once one of
    them has been the same to the last bit for :attr:`PATIENCE_S`:

    - a position that stands still while the velocity says that the joint moves, by more than resolution and
      noise explain;
    - a velocity that stands still, at zero or elsewhere, while the position goes on at another speed;
    - a position that stands still while it is wanted elsewhere: its spring and the whole effort pull by more
      than can hold a joint that sticks (``safety.stiction_nm``; twice as much against the way that it came),
      or by a little, where the velocity is the same as well and not zero, or where velocities are estimated
      from positions and the joint has stopped dead. It must act for long enough to move all the inertia that
      the springs can damp (:func:`~.motion_rules.largest_inertia`). Not beyond a soft limit, where a joint
      may lean on a stop; not where a noisy velocity tells that the joint stands. The effort alone tells
      nothing: what was learned holds a joint still while others pull at it.

    An encoder at rest gives the same position for ever, and a slow one with 12 bits does for 0.1 s: neither
    contradicts itself. Position drives have no springs to wind up here: their efforts are not judged.
    """

    PATIENCE_S, STATES = 0.05, 6
    LEAST_RAD, STEPS = 0.005, 3.0
    """A contradiction is larger than this, and than so many steps of the encoder..."""
    REST_RAD_S, OTHER_SPEED_RAD_S = 0.06, 0.1
    """... faster than what an offset of the velocity explains, or its resolution, ..."""
    SIGMAS = 5.0
    """... and above its noise by so many standard deviations."""
    FINE_CHANGES = 50
    """A velocity that has always changed with the position is too fine to repeat itself in motion."""
    MEMORY_S = 0.01
    DEAD_STEPS = 8.0
    """A joint that covered so many steps, and the least distance above, in the time of the patience does not
    stop between two states."""
    STICTION_SHARE, LITTLE_SHARE, MOVES_RAD_S = 0.05, 0.01, 0.003
    STICTION_FACTOR = 1.5
    """What may hold a joint at rest, by the dry friction that is known of it."""
    WITNESS_TURNS = 6
    """A velocity that has turned round so often since the position stands is measured on its own."""
    PULLED_S, PULLED_STEPS, USUAL_STEP_RAD = 0.012, 2.0, 1e-4
    """For how long an effort has to pull, longer than noise; how far it should have moved a joint, in steps
    of its encoder, or of one with 16 bits until a step has been seen."""

    def __init__(self, arm: ArmConfig, safety: SafetyConfig) -> None:
        limits = arm.effort_limit_nm
        self._joints, self._inertia_kgm2 = arm.joints, largest_inertia(arm).tolist()
        self._low_rad, self._high_rad = (ends.tolist() for ends in soft_range(arm, safety))
        self._little_nm = tuple(self.LITTLE_SHARE * limit for limit in limits)
        self._stiction_nm = safety.stiction_nm or tuple(self.STICTION_SHARE * limit for limit in limits)
        if arm.command_interface == "position":
            self._little_nm = self._stiction_nm = (math.inf,) * len(limits)
        self._seen: list[FrozenJoint] = []
        self._last_ns = 0
        self.fault = ""
        """Which readings contradict each other, in words; empty: none do."""

    @classmethod
    def stiction_nm(cls, arm: ArmConfig, friction_nm: Sequence[float]) -> tuple[float, ...]:
        """Return ``safety.stiction_nm`` for joints with so much dry friction; empty: the usual is enough."""
        usual_nm = [cls.STICTION_SHARE * limit for limit in arm.effort_limit_nm]
        needed_nm = [cls.STICTION_FACTOR * friction for friction in friction_nm]
        if all(needed <= usual for needed, usual in zip(needed_nm, usual_nm, strict=True)):
            return ()
        return tuple(map(max, needed_nm, usual_nm))

    def look(
        self,
        state: ArmState,
        acted_nm: FloatArray,
        pull_nm: Callable[[int], float] | None,
        longest_gap_s: float,
    ) -> None:
        """Take in a state and the effort that acted until then, shape (n_joints,).

        ``pull_nm`` tells how hard a joint's spring pulls to the wanted position; None: none is wanted.
        """
        last_ns, self._last_ns, self.fault = self._last_ns, state.time_ns, ""
        step_s = (state.time_ns - last_ns) / NS_PER_S
        if not (self._seen and 0.0 < step_s <= longest_gap_s):
            self._seen = list(map(FrozenJoint, state.positions, state.velocities, state.positions))
            return
        enough = self.STATES
        # In the control loop: a joint that moves is done with after few comparisons.
        for j, (joint, q, v) in enumerate(zip(self._seen, state.positions, state.velocities)):
            before = joint.velocity
            if v != before:
                if joint.told_for and joint.position != joint.position_at:
                    joint.changes = -1
                elif joint.changes >= 0:
                    joint.changes += 1
                joint.velocity, joint.told_for = v, 0
            else:
                if not joint.told_for:
                    joint.velocity_ns, joint.position_at = last_ns, joint.position
                joint.told_for += 1
            if q == joint.position:
                joint.stand(last_ns, step_s, v, before)
                if joint.stood_for == enough - 1 or (joint.stood_for >= enough and joint.pull_nm is None):
                    joint.pull_nm = None if pull_nm is None else pull_nm(j)
                    joint.effort_nm = float(acted_nm[j])
            else:
                change = abs(q - joint.position)
                if change < joint.step_rad:
                    joint.step_rad = change
                if state.estimated:
                    since_s = (state.time_ns - joint.position_ns) / NS_PER_S if joint.stood_for else step_s
                    share = min(1.0, since_s / self.MEMORY_S)
                    joint.own_speed += share * (change / since_s - joint.own_speed)
                joint.was_at, joint.position, joint.stood_for = joint.position, q, 0
            if (joint.stood_for >= enough or joint.told_for >= enough) and not self.fault:
                found = self._found(j, joint, state, step_s, acted_nm, pull_nm)
                self.fault = f"the readings of {self._joints[j]} are frozen: {found}" if found else ""

    def _found(
        self,
        j: int,
        joint: FrozenJoint,
        state: ArmState,
        step_s: float,
        acted_nm: FloatArray,
        pull_nm: Callable[[int], float] | None,
    ) -> str:
        v, told_for = joint.velocity, joint.told_for
        step_rad = 0.0 if joint.step_rad == math.inf else joint.step_rad
        least_rad = max(self.LEAST_RAD, self.STEPS * step_rad)
        told_s = (state.time_ns - joint.velocity_ns) / NS_PER_S if told_for else 0.0
        told_long = told_for >= self.STATES and told_s >= self.PATIENCE_S
        stood_s = (state.time_ns - joint.position_ns) / NS_PER_S if joint.stood_for else 0.0
        if joint.stood_for >= self.STATES and stood_s >= self.PATIENCE_S:
            stays = f"it stays at {joint.position:.3f} rad for {stood_s:.3f} s, "
            moved, noise = abs(joint.moved_rad), 0.5 * self.SIGMAS**2 * joint.jitter
            if moved > max(least_rad, self.REST_RAD_S * stood_s) and moved**2 > noise:
                return f"{stays}and is said to move at {v:.2f} rad/s"
            change_nm, hint = float(acted_nm[j]) - joint.effort_nm, ""
            pulled_nm = 0.0 if pull_nm is None else pull_nm(j) - (joint.pull_nm or 0.0)
            # A joint that stopped between two states does not stick.
            dead = self.PATIENCE_S * joint.own_speed > max(self.LEAST_RAD, self.DEAD_STEPS * step_rad)
            if (told_long and abs(v) > self.MOVES_RAD_S) or (state.estimated and dead):
                stuck_nm = self._little_nm[j]
            else:
                now_nm = self._stiction_nm[j]
                hint = f" (or it sticks: then safety.stiction_nm, now {now_nm:g}, has to be more)"
                came = joint.position - joint.was_at
                stuck_nm = now_nm * (2.0 if came * change_nm < 0.0 else 1.0)
                pulled_nm = pulled_nm if pulled_nm * change_nm > 0.0 else 0.0
                if told_for < self.STATES and joint.turns >= self.WITNESS_TURNS and not state.estimated:
                    stuck_nm = math.inf
            pulls = min(abs(change_nm), abs(pulled_nm)) > stuck_nm
            joint.pulled_s = joint.pulled_s + step_s if pulls else 0.0
            way_rad = 0.5 * abs(change_nm) / self._inertia_kgm2[j] * joint.pulled_s**2
            free = self._low_rad[j] <= joint.position <= self._high_rad[j] and joint.pulled_s > self.PULLED_S
            if free and way_rad > self.PULLED_STEPS * (step_rad or self.USUAL_STEP_RAD):
                return f"{stays}while its effort has changed by {abs(change_nm):.2f} N·m{hint}"
        elif told_long:
            moved = state.positions[j] - joint.position_at
            other = abs(moved - v * told_s) > max(2.0 * least_rad, self.OTHER_SPEED_RAD_S * told_s)
            exact = joint.changes >= self.FINE_CHANGES and told_s > 1.5 * self.PATIENCE_S
            if other or (exact and abs(moved) > least_rad):
                return f"its velocity stays at {v:.2f} rad/s while it moves {moved:.3f} rad in {told_s:.3f} s"
        return ""


class FirstMotion:
    """Watches an arm until it has completed a trial: is it wired as it is described?

    With a sign that is wrong, two joints that are swapped or a joint in other units the springs drive what
    they should hold, faster and faster. A brake would do the same, so nothing may act any more. Found is

    - a joint that moves away from where it is pulled and gets faster by that. A joint that falls, or that
      another one carries along, gives way less the further it gets: with a constant force it covers each
      further doubling of the distance in 1.41 times the time. One that its spring drives needs the same time,
      and no longer than the largest inertia that the spring may have to move takes. An unlearned arm that
      sags under gravity is slower, or goes on at another pace;
    - efforts that swing from one side to the other faster than an arm moves.
    """

    FIRST_RAD, FIRST_STEPS, SURE_RAD = 0.0025, 6.0, 0.039
    """The distance, also in steps of the encoder, from which on doublings are timed; from where on two of
    them are enough, instead of three."""
    SHORTER, LONGER = 0.8, 1.1
    """How long a doubling has to take, by the one before it, to be the spring's."""
    DOUBLING, MARGIN = 0.93, 1.4
    """Time that x takes to double in I ẍ = K x - B ẋ with a damping ratio of 0.3, in units of √(I / K):
    ln 2 / (√(1 + ζ²) - ζ). A wrong sign of B as well makes it shorter."""
    STRONG_SHARE, SWINGS, SWINGS_S, SWING_STEPS = 0.2, 4, 0.1, 3.0

    def __init__(self, arm: ArmConfig) -> None:
        self._joints = arm.joints
        self._strong: list[float] = (self.STRONG_SHARE * np.array(arm.effort_limit_nm)).tolist()
        slowest_s = np.sqrt(largest_inertia(arm) / np.array(arm.stiffness_nm_per_rad))
        self._longest_s: list[float] = (self.MARGIN * self.DOUBLING * slowest_s).tolist()
        self.begin([0.0] * len(self._joints))

    def begin(self, positions: Sequence[float]) -> None:
        """Begin from where the joints are."""
        self._watched = [_WatchedJoint(q, q, q, q) for q in positions]
        self._last_s = 0.0

    def look(self, state: ArmState, equilibrium_rad: FloatArray, effort_nm: FloatArray) -> str:
        """Take in a tick; return what is wrong in words, or nothing. Shapes (n_joints,)."""
        now_s, found, near, strongs = state.time_ns / NS_PER_S, "", 0.5 * self.FIRST_RAD, self._strong
        rows = zip(self._watched, state.positions, equilibrium_rad.tolist(), effort_nm.tolist())
        # In the control loop: a joint that does what it should is done with after few comparisons.
        for j, (joint, q, u, effort) in enumerate(rows):
            if u < joint.low:
                joint.low = u
            elif u > joint.high:
                joint.high = u
            below, above, change = joint.low - q, q - joint.high, abs(q - joint.before)
            away = below if below > above else above
            if 0.0 < change < joint.step_rad:
                joint.step_rad = change
            if (away >= near or joint.times) and self._runs_away(joint, away, now_s, self._longest_s[j]):
                found = (
                    f"{self._joints[j]} moves away from where it is pulled, faster and faster "
                    f"({away:.3f} rad so far): a sign, a unit or the order of the joints is wrong"
                )
            elif not -strongs[j] < effort < strongs[j] and self._swings_about(joint, q, effort > 0.0, now_s):
                found = (
                    f"the effort of {self._joints[j]} swings from side to side: it moves faster than it can "
                    "have been pulled (a unit that is wrong, noise, or too much damping for so light a joint)"
                )
            joint.away, joint.before = away, q
        self._last_s = now_s
        return found

    def _runs_away(self, joint: _WatchedJoint, away: float, now_s: float, longest_s: float) -> bool:
        times, before = joint.times, joint.away
        if away < 0.5 * self.FIRST_RAD:
            times.clear()
            joint.driven = False
            return False
        while away >= (mark := self.FIRST_RAD * 2.0 ** len(times)):
            share = (mark - before) / (away - before) if away > before else 1.0
            times.append(self._last_s + min(max(share, 0.0), 1.0) * (now_s - self._last_s))
            if len(times) < 3:
                continue
            before_s, last_s = times[-2] - times[-3], times[-1] - times[-2]
            driven = self.SHORTER * before_s <= last_s <= min(self.LONGER * before_s, longest_s)
            coarse = 0.25 * mark < self.FIRST_STEPS * joint.step_rad
            if driven and not coarse and (joint.driven or mark >= self.SURE_RAD):
                return True
            joint.driven = driven and not coarse
        return False

    def _swings_about(self, joint: _WatchedJoint, q: float, upward: bool, now_s: float) -> bool:
        swings = joint.swings
        # A swing of a step or two is that of the encoder.
        if upward != joint.upward and abs(q - joint.turned_at) > self.SWING_STEPS * joint.step_rad:
            swings.append(now_s)
            joint.upward, joint.turned_at = upward, q
        return len(swings) > self.SWINGS and now_s - swings[-1 - self.SWINGS] <= self.SWINGS_S


@dataclass(slots=True)
class _WatchedJoint:
    """What :class:`FirstMotion` knows of a joint."""

    low: float
    high: float
    """Between which points it has been pulled to."""
    before: float
    turned_at: float
    away: float = 0.0
    upward: bool = False
    step_rad: float = math.inf
    times: list[float] = field(default_factory=list)
    driven: bool = False
    """When it passed the marks; whether the last doubling took as long as a spring's."""
    swings: list[float] = field(default_factory=list)
