"""What the arm's own reports tell about its sensors, drives and wiring; each monitor ends a trial by name.

Unlike the rules they narrow nothing as long as they find nothing.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from tel_ros.core.arm_state import ArmState
from tel_ros.core.config import ArmConfig, SafetyConfig
from tel_ros.core.safety.motion_rules import largest_inertia, soft_range
from tel_ros.core.types import NS_PER_S, FloatArray


class FrozenJoint:
    """How long the readings of one joint have been the same to the last bit, and what that hides."""

    __slots__ = (
        *(
            "direction",
            "effort_nm",
            "jitter",
            "moved_rad",
            "own_speed",
            "position",
            "position_at",
            "position_ns",
        ),
        *("pull_nm", "pulled_s", "step_rad", "stood_for", "told_for", "velocity", "velocity_ns", "changes"),
    )

    def __init__(self, time_ns: int, q: float, v: float, effort_nm: float) -> None:
        self.position = self.position_at = q
        self.velocity = v
        self.position_ns = self.velocity_ns = time_ns
        self.stood_for = self.told_for = 0
        """States in which position and velocity have been the same."""
        self.moved_rad = self.jitter = self.own_speed = 0.0
        """The velocity's integral over that time, and its noise; speed of the position before."""
        self.step_rad, self.changes = 0.0, 0
        """Smallest change of the position so far: its resolution; how often the velocity has changed, -1 once
        it has stayed the same while the joint moved: then it is coarse."""
        self.effort_nm, self.direction, self.pulled_s = effort_nm, 0, 0.0
        """What acted when the position stood still; where it had gone to, 0: it has not moved; for how long
        the effort has been far from that."""
        self.pull_nm: float | None = None
        """How hard the spring alone pulled then towards the wanted position."""

    def take(self, time_ns: int, step_s: float, q: float, v: float, effort_nm: float) -> None:
        """Take in a reading."""
        before = self.velocity
        if v != before:
            coarse = self.told_for and self.position != self.position_at
            self.changes = -1 if coarse or self.changes < 0 else self.changes + 1
            self.velocity, self.velocity_ns, self.told_for, self.position_at = v, time_ns, 0, q
        else:
            self.told_for += 1
        if q == self.position:
            self.stood_for += 1
            self.moved_rad += v * step_s
            self.jitter += (step_s * (v - before)) ** 2
            return
        change, since_s = abs(q - self.position), (time_ns - self.position_ns) / NS_PER_S
        self.direction = 1 if q > self.position else -1
        self.step_rad = min(change, self.step_rad or change)
        self.own_speed += min(1.0, since_s / FrozenReadings.MEMORY_S) * (change / since_s - self.own_speed)
        self.position, self.position_ns, self.stood_for, self.pulled_s = q, time_ns, 0, 0.0
        self.moved_rad = self.jitter = 0.0


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
      may lean on a stop. The effort alone tells nothing: what was learned holds a joint still while others
      pull at it.

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
    PULLED_S, PULLED_STEPS, USUAL_STEP_RAD = 0.012, 2.0, 1e-4
    """For how long an effort has to pull, longer than noise; how far it should have moved a joint, in steps
    of its encoder, or of one with 16 bits until a step has been seen."""

    def __init__(
        self,
        joints: Sequence[str],
        stiction_nm: Sequence[float],
        little_nm: Sequence[float],
        inertia_kgm2: Sequence[float],
        soft_range_rad: tuple[FloatArray, FloatArray],
    ) -> None:
        self._joints, self._inertia_kgm2 = tuple(joints), inertia_kgm2
        self._stiction_nm, self._little_nm, self._soft_range = stiction_nm, little_nm, soft_range_rad
        self._seen: list[FrozenJoint] = []
        self._last_ns, self._step_s = 0, 0.0
        self.fault = ""
        """Which readings contradict each other, in words; empty: none do."""

    @classmethod
    def of(cls, arm: ArmConfig, safety: SafetyConfig) -> FrozenReadings:
        """Return it for a configured arm."""
        limits, judged = arm.effort_limit_nm, arm.command_interface == "effort"
        stiction = safety.stiction_nm or [cls.STICTION_SHARE * limit for limit in limits]
        little = [cls.LITTLE_SHARE * limit for limit in limits]
        never = [float("inf")] * len(limits)
        stuck = (stiction, little) if judged else (never, never)
        return cls(arm.joints, *stuck, largest_inertia(arm).tolist(), soft_range(arm, safety))

    def look(
        self, state: ArmState, acted_nm: FloatArray, pull_nm: FloatArray | None, longest_gap_s: float
    ) -> None:
        """Take in a state, the effort that acted until then, and the springs' pull to the wanted position.

        Shapes (n_joints,); no pull: no position is wanted.
        """
        step_s = (state.time_ns - self._last_ns) / NS_PER_S
        self._last_ns, self._step_s, self.fault = state.time_ns, step_s, ""
        rows = zip(state.position_rad.tolist(), state.velocity_rad_s.tolist(), acted_nm.tolist(), strict=True)
        if not (self._seen and 0.0 < step_s <= longest_gap_s):
            self._seen = [FrozenJoint(state.time_ns, *row) for row in rows]
            return
        for j, (joint, row) in enumerate(zip(self._seen, rows, strict=True)):
            joint.take(state.time_ns, step_s, *row)
            if joint.stood_for < self.STATES or joint.pull_nm is None:
                joint.pull_nm, joint.effort_nm = None if pull_nm is None else float(pull_nm[j]), row[2]
            if max(joint.stood_for, joint.told_for) >= self.STATES and not self.fault:
                pulled_nm = 0.0 if pull_nm is None else float(pull_nm[j]) - (joint.pull_nm or 0.0)
                found = self._found(j, joint, state, row[2], pulled_nm)
                self.fault = f"the readings of {self._joints[j]} are frozen: {found}" if found else ""

    def _found(self, j: int, joint: FrozenJoint, state: ArmState, acted_nm: float, pulled_nm: float) -> str:
        v, least_rad = joint.velocity, max(self.LEAST_RAD, self.STEPS * joint.step_rad)
        stood_s = (state.time_ns - joint.position_ns) / NS_PER_S
        told_s = (state.time_ns - joint.velocity_ns) / NS_PER_S
        if joint.stood_for >= self.STATES and stood_s >= self.PATIENCE_S:
            stays = f"it stays at {joint.position:.3f} rad for {stood_s:.3f} s, "
            moved, noise = abs(joint.moved_rad), 0.5 * self.SIGMAS**2 * joint.jitter
            if moved > max(least_rad, self.REST_RAD_S * stood_s) and moved**2 > noise:
                return f"{stays}and is said to move at {v:.2f} rad/s"
            told_too = joint.told_for >= self.STATES and told_s >= self.PATIENCE_S
            change_nm = acted_nm - joint.effort_nm
            hint = ""
            if self._cannot_stick(joint, told_too, state.estimated):
                stuck_nm = self._little_nm[j]
            else:
                hint = " (or it sticks: then safety.stiction_nm has to be more)"
                stuck_nm = self._stiction_nm[j] * (2.0 if joint.direction * change_nm < 0.0 else 1.0)
                pulled_nm = pulled_nm if pulled_nm * change_nm > 0.0 else 0.0
            pulls = min(abs(change_nm), abs(pulled_nm)) > stuck_nm
            joint.pulled_s = joint.pulled_s + self._step_s if pulls else 0.0
            way_rad = 0.5 * abs(change_nm) / self._inertia_kgm2[j] * joint.pulled_s**2
            low_rad, high_rad = self._soft_range[0][j], self._soft_range[1][j]
            free = low_rad <= joint.position <= high_rad and joint.pulled_s > self.PULLED_S
            if free and way_rad > self.PULLED_STEPS * (joint.step_rad or self.USUAL_STEP_RAD):
                return f"{stays}while its effort has changed by {abs(change_nm):.2f} N·m{hint}"
        elif joint.told_for >= self.STATES and told_s >= self.PATIENCE_S:
            moved = state.position_rad[j] - joint.position_at
            other = abs(moved - v * told_s) > max(2.0 * least_rad, self.OTHER_SPEED_RAD_S * told_s)
            exact = joint.changes >= self.FINE_CHANGES and told_s > 1.5 * self.PATIENCE_S
            if other or (exact and abs(moved) > least_rad):
                return f"its velocity stays at {v:.2f} rad/s while it moves {moved:.3f} rad in {told_s:.3f} s"
        return ""

    def _cannot_stick(self, joint: FrozenJoint, told_too: bool, estimated: bool) -> bool:
        """Return whether a joint that stands still is said to move, or has stopped dead."""
        stopped_rad = self.PATIENCE_S * joint.own_speed
        dead = stopped_rad > max(self.LEAST_RAD, self.DEAD_STEPS * joint.step_rad)
        return (told_too and abs(joint.velocity) > self.MOVES_RAD_S) or (estimated and dead)


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
    STRONG_SHARE, SWINGS, SWINGS_S, SWING_STEPS = 0.2, 4, 0.1, 3.0

    def __init__(self, joints: Sequence[str], limit_nm: FloatArray) -> None:
        self._joints = tuple(joints)
        self._strong: list[float] = (self.STRONG_SHARE * limit_nm).tolist()
        self.begin(np.zeros(len(joints)))

    def begin(self, position_rad: FloatArray) -> None:
        """Begin from where the arm is; shape (n_joints,)."""
        n = len(self._joints)
        self._low, self._high = position_rad.tolist(), position_rad.tolist()
        self._times: list[list[float]] = [[] for _ in range(n)]
        self._swings: list[list[float]] = [[] for _ in range(n)]
        self._turned_at, self._before = list(self._low), list(self._low)
        self._step_rad = [math.inf] * n
        self._away, self._upward, self._last_s = [0.0] * n, [False] * n, 0.0

    def look(self, state: ArmState, equilibrium_rad: FloatArray, effort_nm: FloatArray) -> str:
        """Take in a tick; return what is wrong in words, or nothing. Shapes (n_joints,)."""
        now_s, found = state.time_ns / NS_PER_S, ""
        rows = zip(state.position_rad.tolist(), equilibrium_rad.tolist(), effort_nm.tolist(), strict=True)
        for j, (q, u, effort) in enumerate(rows):
            self._low[j], self._high[j] = min(self._low[j], u), max(self._high[j], u)
            away = max(self._low[j] - q, q - self._high[j])
            if self._runs_away(j, away, now_s):
                found = (
                    f"{self._joints[j]} moves away from where it is pulled, faster and faster "
                    f"({away:.3f} rad so far): a sign, a unit or the order of the joints is wrong"
                )
            elif self._swings_about(j, q, effort, now_s):
                found = (
                    f"the effort of {self._joints[j]} swings from side to side: it moves faster than it can "
                    "have been pulled (a unit that is wrong, or too much damping for so light a joint)"
                )
            self._away[j] = away
        self._last_s = now_s
        return found

    def _runs_away(self, j: int, away: float, now_s: float) -> bool:
        times, before = self._times[j], self._away[j]
        if away < 0.5 * self.FIRST_RAD:
            if times:
                times.clear()
            return False
        while away >= (mark := self.FIRST_RAD * 2.0 ** len(times)):
            share = (mark - before) / (away - before) if away > before else 1.0
            times.append(self._last_s + min(max(share, 0.0), 1.0) * (now_s - self._last_s))
            if len(times) >= 3 and times[-1] - times[-2] <= self.LONGER * (times[-2] - times[-3]):
                return True
        return False

    def _swings_about(self, j: int, q: float, effort: float, now_s: float) -> bool:
        swings, change, self._before[j] = self._swings[j], abs(q - self._before[j]), q
        if change:
            self._step_rad[j] = min(self._step_rad[j], change)
        if abs(effort) < self._strong[j]:
            return False
        # A swing of a step or two is that of the encoder.
        moved = abs(q - self._turned_at[j]) > self.SWING_STEPS * self._step_rad[j]
        if moved and (effort > 0.0) != self._upward[j]:
            swings.append(now_s)
            self._upward[j], self._turned_at[j] = effort > 0.0, q
        return len(swings) > self.SWINGS and now_s - swings[-1 - self.SWINGS] <= self.SWINGS_S
