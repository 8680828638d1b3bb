"""What goes into the control loop and what comes out of it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum
from typing import Literal, NamedTuple

from tel_ros.core.control.loop_timing import LoopTiming
from tel_ros.core.control.springs import Springs
from tel_ros.core.errors import StateError, TrajectoryError
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
class ArmState:
    """One measured state. Arrays of shape (n_joints,).

    Args:
        time_ns: when it was measured.
        position_rad: as measured.
        velocity_rad_s: as measured.
        age_s: how late it has come (:class:`~tel_ros.core.safety.latency.Latency`); 0 where none can tell.
        effort_nm: what the motors are said to have exerted until then; None: nothing is said.

    Raises:
        StateError: a value is not finite.
    """

    time_ns: int
    position_rad: FloatArray
    velocity_rad_s: FloatArray
    age_s: float = 0.0
    effort_nm: FloatArray | None = None

    def __post_init__(self) -> None:
        # A sum is finite only if all of its terms are, and in the control loop it costs less than isfinite.
        if not math.isfinite(sum(self.position_rad.tolist()) + sum(self.velocity_rad_s.tolist())):
            raise StateError(
                f"the joint state has position {self.position_rad.tolist()} rad and velocity "
                f"{self.velocity_rad_s.tolist()} rad/s; expected finite numbers"
            )


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
