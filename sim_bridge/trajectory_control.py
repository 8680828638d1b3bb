"""The law of ros2_control's joint_trajectory_controller (Jazzy) with an effort command interface; no ROS.

effort = ff_velocity_scale ẏ + effort of the trajectory + p (y - q) + i ∫ (y - q) + d (ẏ - q̇), where y is the
trajectory now, and what goes before p is the trajectory one period later. Which goals it takes, when it gives
them up, what it says then and what it holds afterwards is that controller's behaviour, as its sources and
documentation tell it (``joint_trajectory_controller`` 4.42):

- A goal that is reached leaves the arm held at its last point, with the effort of that point.
- A goal that is aborted or cancelled leaves the arm held where it is at that moment, with the effort of the
  last point of the last goal that was reached, or with none: ``set_hold_position`` replaces positions alone.
- The period in which a tolerance is violated repeats the command of the one before.

What is off by default there is left out: partial goals, ``cmd_timeout``, ``decelerate_on_cancel``, scaling.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from sim_bridge.splines import FIELDS, Points, Spline
from tel_ros.core.control.trajectory_points import ErrorCode as Code
from tel_ros.core.types import NS_PER_S, BoolArray, FloatArray


class End(NamedTuple):
    """The end of a goal."""

    code: Code
    text: str
    why: str = ""
    """Which joint it was, for a log."""


CANCELLED = End(Code.SUCCESSFUL, "")
PREEMPTED = End(Code.INVALID_GOAL, "Current goal preempted by new incoming action.")
REACHED = End(Code.SUCCESSFUL, "Goal successfully reached!")
LEFT_THE_PATH = "Aborted due to path tolerance violation"

_ERASED = -1.0


@dataclass(frozen=True)
class Gains:
    """Of each joint, shape (n_joints,)."""

    p: FloatArray
    i: FloatArray
    d: FloatArray
    ff_velocity_scale: FloatArray


@dataclass(frozen=True)
class Tolerances:
    """How far position and velocity may be off, shape (2, n_joints); inf: as far as they like."""

    path: FloatArray
    goal: FloatArray
    goal_time_s: float
    """How long after its end a goal may take to be reached; 0: for ever."""
    remarks: tuple[str, ...] = field(default=(), compare=False)

    @classmethod
    def of(
        cls, path_rad: Sequence[float], goal_rad: Sequence[float], stopped_rad_s: float, goal_time_s: float
    ) -> Tolerances:
        """Return those that a controller is configured with; 0: none."""
        path = np.array([path_rad, np.zeros(len(path_rad))])
        goal = np.array([goal_rad, np.full(len(goal_rad), stopped_rad_s)])
        path, goal = (np.where(each > 0.0, each, math.inf) for each in (path, goal))
        return cls(path, goal, goal_time_s)

    def asked_for(self, goal: Any, joints: Sequence[str]) -> Tolerances:
        """Return them as a FollowJointTrajectory goal changes them; where it makes no sense, as they are."""
        seconds = goal.goal_time_tolerance.sec + goal.goal_time_tolerance.nanosec / NS_PER_S
        try:
            return Tolerances(
                _changed(self.path, goal.path_tolerance, joints),
                _changed(self.goal, goal.goal_tolerance, joints),
                _resolved(seconds, self.goal_time_s, 0.0),
            )
        except ValueError as error:
            remark = f"{error}; the goal has the tolerances that are configured"
            return Tolerances(self.path, self.goal, self.goal_time_s, (remark,))


def _changed(default: FloatArray, asked: Iterable[Any], joints: Sequence[str]) -> FloatArray:
    changed = default.copy()
    for each in asked:
        if each.name not in joints:
            raise ValueError(f"a tolerance is for {each.name!r}; expected one of {list(joints)}")
        j = joints.index(each.name)
        for row, value in enumerate((each.position, each.velocity)):
            changed[row, j] = _resolved(value, default[row, j], math.inf)
    return changed


def _resolved(asked: float, default: float, erased: float) -> float:
    if asked > 0.0 or asked == 0.0:
        return asked or default
    if abs(asked - _ERASED) < np.finfo(np.float32).eps:
        return erased
    raise ValueError(f"a tolerance is {asked}; expected more than 0, 0 (as configured) or -1 (none)")


class TrajectoryController:
    """Follows one trajectory at a time. To be updated once a period, with every state.

    At first it holds the position of the first state. ``starts_from_command``: a trajectory begins where the
    one before has last sent the arm, not where the arm is (``interpolate_from_desired_state``).
    """

    def __init__(
        self, joints: Sequence[str], rate_hz: float, gains: Gains, *, starts_from_command: bool = False
    ) -> None:
        self.joints, self.gains = tuple(joints), gains
        self._period_ns = round(NS_PER_S / rate_hz)
        self._starts_from_command = starts_from_command
        n = len(self.joints)
        self._tolerances = Tolerances.of((0.0,) * n, (0.0,) * n, 0.0, 0.0)
        self._next: Points | None = None
        self._spline = Spline(Points.hold(np.zeros(n)), 0, 0, np.zeros((len(FIELDS), n)))
        self._sampled: tuple[int, FloatArray] | None = None
        self._integral = np.zeros(n)
        self._commanded: tuple[int, FloatArray] | None = None
        self._reached_nm = np.zeros(n)
        self.holding = True
        """Whether it has nothing to follow: tolerances do not count."""
        self.has_goal = False
        """Whether somebody waits for the end."""
        self.time_ns: int | None = None
        """Of the state that it was updated with last; None: of none yet."""
        self.measured = np.full((2, n), math.nan)
        """That state, shape (2, n_joints), as the next two."""
        self.desired = np.full((len(FIELDS), n), math.nan)
        """The trajectory at that time; more rows: acceleration, effort."""
        self.error = np.full((2, n), math.nan)
        self.effort_nm = np.zeros(n)
        """The command since then, shape (n_joints,); not limited."""

    @property
    def moves(self) -> bool:
        """Whether there is something to follow, or to take up."""
        ends = self.time_ns is not None and self.time_ns >= self._spline.end_ns
        return self._next is not None or self.has_goal or not (self.holding or ends)

    @property
    def start_ns(self) -> int:
        """When the trajectory began that is followed."""
        return self._spline.start_ns

    def follow(self, points: Points, tolerances: Tolerances | None = None) -> End | None:
        """Follow a trajectory from the next state on, and return the end of the goal before, if any.

        ``tolerances``: of a goal. None: it is none, those of the last one stay, and a goal that is under way
        goes on with this trajectory instead.
        """
        ended = None
        if tolerances is not None:
            ended = PREEMPTED if self.has_goal else None
            self._tolerances, self.has_goal = tolerances, True
        self._next, self.holding = points, False
        return ended

    def cancel(self) -> End:
        """Give the goal up, and hold the arm where it was last."""
        self._hold()
        return CANCELLED

    def update(
        self, time_ns: int, position_rad: Sequence[float], velocity_rad_s: Sequence[float]
    ) -> End | None:
        """Make :attr:`effort_nm` from a state, and return the end of what is followed, if it ends with it.

        A trajectory that is no goal ends only by being given up.
        """
        first = self._next is not None or self.time_ns is None
        period_s = (self._period_ns if self.time_ns is None else time_ns - self.time_ns) / NS_PER_S
        self.time_ns, self.measured = time_ns, np.array((position_rad, velocity_rad_s))
        if first:
            self._take_up(time_ns)
        self.desired = self._sample(time_ns)
        ahead = self._sample(time_ns + self._period_ns)
        self.error = self.desired[:2] - self.measured
        arriving = time_ns + self._period_ns >= self._spline.end_ns
        if self.holding:
            self._command(time_ns, ahead, period_s)
            return None
        wrong = np.abs(self.error) > self._tolerances.path
        if (first or not arriving) and wrong.any():
            return self._give_up(Code.PATH_TOLERANCE_VIOLATED, LEFT_THE_PATH, wrong, self._tolerances.path)
        if arriving:
            wrong = np.abs(self.error) > self._tolerances.goal
            over_s = (time_ns - self._spline.end_ns) / NS_PER_S
            if self.has_goal and not wrong.any():
                self._command(time_ns, ahead, period_s)
                self.has_goal, self.holding = False, True
                self._reached_nm = ahead[3]
                return REACHED
            if wrong.any() and 0.0 < self._tolerances.goal_time_s < over_s:
                text = f"Aborted due to goal_time_tolerance exceeding by {over_s:.6f} seconds"
                return self._give_up(Code.GOAL_TOLERANCE_VIOLATED, text, wrong, self._tolerances.goal)
        self._command(time_ns, ahead, period_s)
        return None

    def _take_up(self, time_ns: int) -> None:
        points = self._next or Points.hold(self.measured[0])
        nothing = np.full(len(self.joints), math.nan)
        since_ns, before = time_ns, np.array((*self.measured, nothing, self.effort_nm))
        if self._starts_from_command and self._commanded is not None:
            since_ns, before = self._commanded
        self._spline, self._next, self._sampled = Spline(points, time_ns, since_ns, before), None, None

    def _sample(self, time_ns: int) -> FloatArray:
        # What is ahead in one period is there in the next.
        if self._sampled is None or self._sampled[0] != time_ns:
            self._sampled = time_ns, self._spline.sample(time_ns)
        return self._sampled[1]

    def _command(self, time_ns: int, ahead: FloatArray, period_s: float) -> None:
        gains = self.gains
        effort_nm = ahead[1] * gains.ff_velocity_scale + ahead[3] + gains.p * self.error[0]
        if gains.i.any():
            self._integral = self._integral + period_s * gains.i * self.error[0]
            effort_nm = effort_nm + self._integral
        self.effort_nm = effort_nm + gains.d * self.error[1]
        self._commanded = time_ns, ahead

    def _give_up(self, code: Code, text: str, wrong: BoolArray, allowed: FloatArray) -> End:
        row, j = (int(place[0]) for place in np.nonzero(wrong))
        what, unit = (("position", "rad"), ("velocity", "rad/s"))[row]
        off, most = self.error[row, j], allowed[row, j]
        why = f"{what} of {self.joints[j]} is off by {off:.6f} {unit} (tolerance {most:g})"
        self._hold()
        return End(code, text, why)

    def _hold(self) -> None:
        self.has_goal = False
        self._next, self.holding = Points.hold(self.measured[0], self._reached_nm), True
