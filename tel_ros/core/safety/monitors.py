"""What the arm's own reports tell about its sensors, drives and wiring; each monitor ends a trial by its reason.

Unlike the rules they narrow nothing as long as they find nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tel_ros.core.arm_state import ArmState
from tel_ros.core.config import ArmConfig, SafetyConfig
from tel_ros.core.trial import shortfall
from tel_ros.core.types import NS_PER_S, BoolArray, FloatArray

class Permitted(NamedTuple):
    """What the layer made of a wanted effort. Shapes (n_joints,)."""

    effort_nm: FloatArray
    changed: BoolArray


class FrozenJoint:
    """How long the readings of one joint have been the same to the last bit, and what that hides."""

    __slots__ = (
        *("direction", "effort_nm", "jitter", "moved_rad", "own_speed", "position", "position_at", "position_ns"),
        *("pulled_for", "step_rad", "stood_for", "told_for", "velocity", "velocity_ns", "velocity_step"),
    )

    def __init__(self, time_ns: int, q: float, v: float, effort_nm: float) -> None:
        self.position = self.position_at = q
        self.velocity = v
        self.position_ns = self.velocity_ns = time_ns
        self.stood_for = self.told_for = self.pulled_for = 0
        """States in which position and velocity have been the same, and the effort far from what it was."""
        self.moved_rad = self.jitter = self.own_speed = 0.0
        """The velocity's integral over that time, twice its variance as noise; speed of the position before."""
        self.step_rad = self.velocity_step = 0.0
        """Smallest change of position and velocity so far: their resolution."""
        self.effort_nm, self.direction = effort_nm, 0
        """What acted when the position stood still; where it had gone to, 0: it has not moved."""

    def take(self, time_ns: int, step_s: float, q: float, v: float, effort_nm: float) -> None:
        """Take in a reading."""
        before = self.velocity
        if v != before:
            self.velocity_step = min(abs(v - before), self.velocity_step or abs(v - before))
            self.velocity, self.velocity_ns, self.told_for, self.position_at = v, time_ns, 0, q
        else:
            self.told_for += 1
        if q == self.position:
            self.stood_for += 1
            if self.stood_for < FrozenReadings.STATES:
                self.effort_nm = effort_nm  # the dampers' answer to the last step of the encoder has to die away
            self.moved_rad += v * step_s
            self.jitter += (step_s * (v - before)) ** 2
            return
        change, since_s = abs(q - self.position), (time_ns - self.position_ns) / NS_PER_S
        self.direction = 1 if q > self.position else -1
        self.step_rad = min(change, self.step_rad or change)
        self.own_speed += min(1.0, since_s / FrozenReadings.MEMORY_S) * (change / since_s - self.own_speed)
        self.position, self.position_ns, self.stood_for, self.pulled_for = q, time_ns, 0, 0
        self.moved_rad = self.jitter = 0.0


class FrozenReadings:
    """Notices readings that stand still although their stamps go on.

    A damper that answers a speed that is not there does not damp, and springs whose joint does not seem to
    move pull without end. So position and velocity are held against each other, joint by joint, once one of
    them has been the same to the last bit for :attr:`PATIENCE_S`:

    - a position that stands still while the velocity says that the joint moves, by more than resolution and
      noise explain;
    - a velocity that stands still, at zero or elsewhere, while the position goes on at another speed;
    - a position that stands still while the effort changes by more than can hold a joint that sticks
      (``safety.stiction_nm``; twice as much against the way that it came, half as much along it), or by a
      little, where the velocity is the same as well and not zero, or where velocities are estimated from
      positions and the joint has stopped dead.

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
    MEMORY_S = 0.01
    DEAD_STEPS = 8.0
    """A joint that covered so many steps, and at least the distance above, in the time of the patience does not
    stop between two states."""
    STICTION_SHARE, LITTLE_SHARE, MOVES_RAD_S = 0.05, 0.01, 0.003

    def __init__(self, joints: Sequence[str], stiction_nm: Sequence[float], little_nm: Sequence[float]) -> None:
        self._joints = tuple(joints)
        self._stiction_nm, self._little_nm = stiction_nm, little_nm
        self._seen: list[FrozenJoint] = []
        self._last_ns = 0
        self.fault = ""
        """Which readings contradict each other, in words; empty: none do."""

    @classmethod
    def of(cls, arm: ArmConfig, safety: SafetyConfig) -> FrozenReadings:
        """Return it for a configured arm."""
        limits, judged = arm.effort_limit_nm, arm.command_interface == "effort"
        stiction = safety.stiction_nm or [cls.STICTION_SHARE * limit for limit in limits]
        little = [cls.LITTLE_SHARE * limit for limit in limits]
        never = [float("inf")] * len(limits)
        return cls(arm.joints, *((stiction, little) if judged else (never, never)))

    def look(self, state: ArmState, acted_nm: FloatArray, longest_gap_s: float) -> None:
        """Take in a state and the effort that acted until then. Shape (n_joints,)."""
        step_s = (state.time_ns - self._last_ns) / NS_PER_S
        self._last_ns, self.fault = state.time_ns, ""
        rows = zip(state.position_rad.tolist(), state.velocity_rad_s.tolist(), acted_nm.tolist(), strict=True)
        if not (self._seen and 0.0 < step_s <= longest_gap_s):
            self._seen = [FrozenJoint(state.time_ns, *row) for row in rows]
            return
        for j, (joint, row) in enumerate(zip(self._seen, rows, strict=True)):
            joint.take(state.time_ns, step_s, *row)
            if max(joint.stood_for, joint.told_for) >= self.STATES and not self.fault:
                found = self._found(j, joint, state, row[2])
                self.fault = f"the readings of {self._joints[j]} are frozen: {found}" if found else ""

    def _found(self, j: int, joint: FrozenJoint, state: ArmState, acted_nm: float) -> str:
        q, v, least_rad = joint.position, joint.velocity, max(self.LEAST_RAD, self.STEPS * joint.step_rad)
        stood_s = (state.time_ns - joint.position_ns) / NS_PER_S
        told_s = (state.time_ns - joint.velocity_ns) / NS_PER_S
        if joint.stood_for >= self.STATES and stood_s >= self.PATIENCE_S:
            stays = f"it stays at {q:.3f} rad for {stood_s:.3f} s, "
            moved = abs(joint.moved_rad)
            noise = 0.5 * self.SIGMAS**2 * joint.jitter
            if moved > max(least_rad, self.REST_RAD_S * stood_s) and moved**2 > noise:
                return f"{stays}and is said to move at {v:.2f} rad/s"
            told_too = joint.told_for >= self.STATES and told_s >= self.PATIENCE_S
            stopped_dead = self.PATIENCE_S * joint.own_speed > max(self.LEAST_RAD, self.DEAD_STEPS * joint.step_rad)
            change_nm = acted_nm - joint.effort_nm
            if (told_too and abs(v) > self.MOVES_RAD_S) or (state.estimated and stopped_dead):
                stuck = self._little_nm[j]
            elif joint.direction:
                stuck = self._stiction_nm[j] * (0.5 if joint.direction * change_nm > 0.0 else 2.0)
            else:
                stuck = self._stiction_nm[j]
            changed_nm = abs(change_nm)
            joint.pulled_for = joint.pulled_for + 1 if changed_nm > stuck else 0
            if joint.pulled_for >= self.STATES:  # noise of the velocity alone does not last
                return f"{stays}while its effort has changed by {changed_nm:.2f} N·m"
        elif joint.told_for >= self.STATES and told_s >= self.PATIENCE_S:
            moved = state.position_rad[j] - joint.position_at
            other = abs(moved - v * told_s) > max(2.0 * least_rad, self.OTHER_SPEED_RAD_S * told_s)
            exact = 50.0 * joint.velocity_step < abs(v) and told_s > 1.5 * self.PATIENCE_S
            if other or (exact and abs(moved) > least_rad):
                return f"its velocity stays at {v:.2f} rad/s while it moves by {moved:.3f} rad in {told_s:.3f} s"
        return ""


class FirstMotion:
    """Watches an arm until it has completed a trial: is it wired as it is described?

    With a sign that is wrong, two joints that are swapped or a joint in other units the springs drive what
    they should hold, faster and faster. A brake would do the same, so nothing may act any more. Found is

    - a joint that moves away from where it is pulled and gets faster by that. A joint that falls, or that
      another one carries along, gives way less the further it gets: with a constant force it covers each
      further doubling of the distance in 1.41 times the time. One that its spring drives needs the same time;
    - efforts that swing from one side to the other faster than an arm moves.
    """

    FIRST_RAD = 0.01
    """The distance from which on doublings are timed."""
    LONGER = 1.15
    STRONG_SHARE, SWINGS, SWINGS_S = 0.2, 4, 0.1

    def __init__(self, joints: Sequence[str], limit_nm: FloatArray) -> None:
        self._joints = tuple(joints)
        self._strong = (self.STRONG_SHARE * limit_nm).tolist()
        self._low = self._high = np.zeros(0)
        self.begin(np.zeros(len(joints)))

    def begin(self, position_rad: FloatArray) -> None:
        """Begin from where the arm is; shape (n_joints,)."""
        n = len(self._joints)
        self._low = self._high = position_rad
        self._times: list[list[float]] = [[] for _ in range(n)]
        self._away, self._last_s = [0.0] * n, 0.0
        self._side = [0] * n
        self._swings: list[list[float]] = [[] for _ in range(n)]

    def look(self, state: ArmState, equilibrium_rad: FloatArray, effort_nm: FloatArray) -> str:
        """Take in a tick; return what is wrong in words, or nothing. Shapes (n_joints,)."""
        now_s = state.time_ns / NS_PER_S
        self._low, self._high = np.minimum(self._low, equilibrium_rad), np.maximum(self._high, equilibrium_rad)
        q = state.position_rad
        away_rad = np.maximum(self._low - q, q - self._high).tolist()
        found = ""
        for j, (away, effort) in enumerate(zip(away_rad, effort_nm.tolist(), strict=True)):
            if self._runs_away(j, away, now_s):
                found = (
                    f"{self._joints[j]} moves away from where it is pulled, faster and faster "
                    f"({away:.3f} rad so far): a sign, a unit or the order of the joints is wrong"
                )
            elif abs(effort) >= self._strong[j] and self._swings_about(j, effort > 0.0, now_s):
                found = (
                    f"the effort of {self._joints[j]} swings from side to side: it moves faster than it can "
                    "have been pulled (a unit that is wrong, or too much damping for so light a joint)"
                )
        self._away, self._last_s = away_rad, now_s
        return found

    def _runs_away(self, j: int, away: float, now_s: float) -> bool:
        times, before = self._times[j], self._away[j]
        if away < 0.5 * self.FIRST_RAD:
            times.clear()
        while away >= (mark := self.FIRST_RAD * 2.0 ** len(times)):
            share = (mark - before) / (away - before) if away > before else 1.0
            times.append(self._last_s + min(max(share, 0.0), 1.0) * (now_s - self._last_s))
            if len(times) >= 3 and times[-1] - times[-2] <= self.LONGER * (times[-2] - times[-3]):
                return True
        return False

    def _swings_about(self, j: int, upward: bool, now_s: float) -> bool:
        side, self._side[j] = self._side[j], 1 if upward else -1
        if side * self._side[j] < 0:
            self._swings[j] = [*self._swings[j][1 - self.SWINGS :], now_s]
        swings = self._swings[j]
        return len(swings) == self.SWINGS and now_s - swings[0] <= self.SWINGS_S


class DriveResponse:
    """Notices motors that do nothing although they are commanded, from the efforts that the arm reports.

    A drive that refuses commands, is switched off by its own emergency stop or has tripped goes on to report
    positions. The controller then sees an arm that falls or stays behind, and would wind its springs up; once
    the drive acts again, all of that would act at once. Found dead, a motor is to be commanded nothing that
    winds up, until it is seen to answer or another trial is begun.

    A joint is judged once it has answered :attr:`ANSWERS_TO_BE_KNOWN` strong commands in a row, because some
    arms report no efforts. Shares are of the effort limit, and of a command for an answer. If it is not
    ``watched``, no fault is ever found.

    A drive that is limited to less than its command is no dead one: it gives what it has. It is told by a
    joint that reports weaker commands as they are (arms report in other units, with other signs, or noise),
    and from some command on no more than before (:attr:`shortfalls`).
    """

    STRONG_SHARE = 0.1
    """A command is strong from here on; weaker ones drown in friction and noise."""
    ANSWER_SHARE = 0.5
    """A motor has answered a command if it reports at least this share of it."""
    WEAK_SHARE = 0.02
    """A motor that was found dead is believed to live again from here on."""
    PATIENCE_S = 0.08
    """For how long a strong command may go unanswered: more than the delays that the arm contract allows."""
    SILENT_STATES = 10
    """... and in at least so many states on end. Where states get lost, a driver's watchdog takes the effort
    away in each longer gap, and the first state after it tells of that alone."""
    OVERDUE_S = 0.02
    """After so long nothing is to be wound up any more: twice the delay that the arm contract allows."""
    ANSWERS_TO_BE_KNOWN = 50
    EXACT_SHARE, EXACT_OF_LIMIT = 0.25, 0.005
    """A report is exact if it is this near to the command, as a share of it and of the limit together."""
    SHORT_SHARE, PLATEAU_SHARE, SHORT_S = 0.7, 0.8, 0.03
    """A drive is limited if it gives less than this share of the command, and at least that of the most that it
    has given, for so long."""

    def __init__(self, joints: Sequence[str], limit_nm: Sequence[float], watched: bool = True) -> None:
        self._joints = tuple(joints)
        self._strong = [self.STRONG_SHARE * limit for limit in limit_nm]
        self._weak = [self.WEAK_SHARE * limit for limit in limit_nm]
        self._limit_nm, self._watched = limit_nm, watched
        self._answers = [0] * len(self._joints)
        self._silent_since_ns: list[int | None] = [None] * len(self._joints)
        self._silences = [0] * len(self._joints)
        self._dead: set[int] = set()
        n = len(self._joints)
        self._exact, self._most_nm = [0] * n, [0.0] * n
        self._short_since_ns: list[int | None] = [None] * n
        self._given: dict[int, tuple[float, float]] = {}
        """By joint that is limited: the most that it has given in this trial, and was commanded meanwhile."""
        self.fault = ""
        """Which joint does not do what, in words; empty: all is well, as far as can be told."""

    @classmethod
    def of(cls, arm: ArmConfig, safety: SafetyConfig) -> DriveResponse:
        """Return it for a configured arm; position drives decide on their efforts themselves."""
        watched = safety.watch_drives and arm.command_interface == "effort"
        return cls(arm.joints, arm.effort_limit_nm, watched)

    def look(self, time_ns: int, commanded_nm: FloatArray, reported_nm: FloatArray | None) -> None:
        """Take in what acted until a stamp, as the arm reports it, and what had been commanded.

        Shapes (n_joints,). NaN where nothing is reported; None: no efforts are reported.
        """
        if not self._watched:
            return
        if reported_nm is None:
            self._end_silences()
            return
        commanded, reported, dead = commanded_nm.tolist(), reported_nm.tolist(), self._dead
        for j, (wanted, found) in enumerate(zip(commanded, reported, strict=True)):
            self._compare(j, time_ns, wanted, found)
            strong = (self._weak if j in dead else self._strong)[j]
            if self._short_since_ns[j] is not None:
                self._silent_since_ns[j] = None
            elif -strong < wanted < strong or found != found:
                self._silent_since_ns[j] = None
            elif found / wanted >= self.ANSWER_SHARE:
                self._answer(j)
            else:
                self._stay_silent(j, time_ns, wanted, found)

    @property
    def waits(self) -> bool:
        """Whether a motor that is known to answer strong commands has not answered the last one."""
        return any(since_ns is not None for since_ns in self._silent_since_ns)

    def is_overdue(self, time_ns: int) -> bool:
        """Return whether a motor that is known to answer strong commands lets one wait for long."""
        return any(
            since_ns is not None and time_ns - since_ns > self.OVERDUE_S * NS_PER_S
            for since_ns in self._silent_since_ns
        )

    def forgive(self) -> None:
        """Try again what was found dead."""
        self._dead.clear()
        self._given.clear()
        self._end_silences()
        self.fault = ""

    def lacking(self, permitted: Permitted) -> BoolArray:
        """Return where an effort will not act as it is wanted: changed on its way, or beyond what is given."""
        if not self._given:
            return permitted.changed
        lacks = permitted.changed.copy()
        for j, (given_nm, _) in self._given.items():
            lacks[j] |= abs(permitted.effort_nm[j]) > given_nm / self.PLATEAU_SHARE
        return lacks

    @property
    def shortfalls(self) -> list[str]:
        """What limited drives have given in this trial, in words."""
        return [shortfall(self._joints[j], *most_nm) for j, most_nm in self._given.items()]

    def _compare(self, j: int, time_ns: int, wanted_nm: float, found_nm: float) -> None:
        """Notice a drive that gives no more than so much."""
        size, given = abs(wanted_nm), found_nm if wanted_nm > 0.0 else -found_nm
        if size < self._weak[j] or found_nm != found_nm:
            self._short_since_ns[j] = None
            return
        most, known = self._most_nm[j], self._exact[j] >= self.ANSWERS_TO_BE_KNOWN
        if abs(size - given) <= self.EXACT_SHARE * size + self.EXACT_OF_LIMIT * self._limit_nm[j]:
            self._exact[j] += 1
            self._most_nm[j] = max(most, given)
        elif not known:
            self._exact[j] = 0
        if not known or given >= self.SHORT_SHARE * size or not self.PLATEAU_SHARE * most <= given:
            self._short_since_ns[j] = None
            return
        self._most_nm[j] = max(most, given)
        since_ns = self._short_since_ns[j]
        if since_ns is None or since_ns > time_ns:
            self._short_since_ns[j] = time_ns
        elif time_ns - since_ns > self.SHORT_S * NS_PER_S:
            before = self._given.get(j, (0.0, 0.0))
            self._given[j] = max(before[0], given), max(before[1], size)

    def _end_silences(self) -> None:
        self._silent_since_ns = [None] * len(self._joints)

    def _answer(self, j: int) -> None:
        self._silent_since_ns[j] = None
        self._answers[j] += 1
        if self._dead:
            self._dead.discard(j)
            if not self._dead:
                self.fault = ""

    def _stay_silent(self, j: int, time_ns: int, wanted_nm: float, found_nm: float) -> None:
        if self._answers[j] < self.ANSWERS_TO_BE_KNOWN:
            self._answers[j] = 0
            return
        since_ns = self._silent_since_ns[j]
        if since_ns is None or since_ns > time_ns:
            self._silent_since_ns[j], self._silences[j] = time_ns, 1
            return
        self._silences[j] += 1
        waited = time_ns - since_ns > self.PATIENCE_S * NS_PER_S and self._silences[j] >= self.SILENT_STATES
        if waited and j not in self._dead:
            self._dead.add(j)
            self.fault = (
                f"the drive of {self._joints[j]} does not exert what it is commanded: it reports "
                f"{found_nm:.2f} of {wanted_nm:.2f} N·m, for more than {self.PATIENCE_S} s"
            )
