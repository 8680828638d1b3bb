"""One trial: what is asked of the arm, what the controller did with each state, and how it went."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Literal, NamedTuple

from tel_ros.core.errors import TrajectoryError
from tel_ros.core.springs import Springs
from tel_ros.core.trajectories.trajectory import DesiredTrajectory, check_points
from tel_ros.core.types import BoolArray, FloatArray


class Phase(IntEnum):
    """Where in a trial the controller is; numbers as in ``ControlState.msg``."""

    IDLE = 0
    APPROACH = 1
    SETTLE = 2
    RUN = 3
    HOLD = 4
    STOP = 5


class Outcome(IntEnum):
    """How a trial ended; numbers as in ``TrialResult.msg``."""

    COMPLETED = 0
    ABORTED = 1
    CANCELLED = 2
    REFUSED = 3


@dataclass(frozen=True)
class TrialGoal:
    """What to do in one trial.

    Args:
        index: number of the trial, for the records.
        alpha: practice parameter, for the records.
        desired: y.
        equilibrium_rad: the command û at the times of ``desired``. Shape (n, n_joints).
        springs: K and B in this trial; None: as configured.

    Raises:
        TrajectoryError: the command does not fit the desired trajectory or is not finite.
    """

    index: int
    alpha: float
    desired: DesiredTrajectory
    equilibrium_rad: FloatArray
    springs: Springs | None = None

    def __post_init__(self) -> None:
        check_points("the equilibrium trajectory", self.equilibrium_rad, self.desired.position_rad.shape)


class Tick(NamedTuple):
    """What the controller did with one state. Arrays of shape (n_joints,)."""

    phase: Phase
    time_from_start_s: float
    desired_position_rad: FloatArray
    desired_velocity_rad_s: FloatArray
    desired_acceleration_rad_s2: FloatArray
    equilibrium_rad: FloatArray
    effort_nm: FloatArray
    saturated: BoolArray

    def command(self, interface: Literal["effort", "position"]) -> FloatArray:
        """Return what the arm gets: efforts in N·m, or equilibrium points in rad. Shape (n_joints,)."""
        return self.effort_nm if interface == "effort" else self.equilibrium_rad


@dataclass(frozen=True, kw_only=True)
class LoopTiming:
    """Figures of one trial, over the joint states that were answered.

    Args:
        state_rate_hz: of the states as they arrived, by the controller's monotonic clock.
        stamp_rate_hz: of the states by their own stamps.
        jitter_p50_s: median deviation of the time between two arrivals from the period.
        jitter_p99_s: 99th percentile of it.
        jitter_max_s: the largest.
        response_p99_s: from taking a state to having sent the command, 99th percentile.
        response_max_s: the longest.
        missed_ticks: periods without an answered state: see ``control.loop_timing.missed_ticks``.
        warning: what is bad about them, in one line; empty: nothing.
    """

    state_rate_hz: float
    stamp_rate_hz: float
    jitter_p50_s: float
    jitter_p99_s: float
    jitter_max_s: float
    response_p99_s: float
    response_max_s: float
    missed_ticks: int
    warning: str = ""


@dataclass(frozen=True)
class TrialReport:
    """How one trial went; errors are measured minus desired position over RUN, NaN if it was not reached."""

    index: int
    alpha: float
    duration_s: float
    outcome: Outcome
    message: str
    start_ns: int
    run_ns: int
    end_ns: int
    ticks: int
    rms_error_rad: float
    rms_error_per_joint_rad: FloatArray
    max_error_rad: float
    max_effort_nm: FloatArray
    saturated_ratio: float
    timing: LoopTiming | None = None
    """How regular the loop was; None: not measured, as in lockstep."""


def require_joint_count(goal: TrialGoal, n_joints: int) -> None:
    """Raise :class:`TrajectoryError` unless the goal is for this number of joints."""
    if goal.desired.n_joints != n_joints:
        raise TrajectoryError(f"the goal has {goal.desired.n_joints} joints; expected {n_joints}")
