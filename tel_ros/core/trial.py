"""One trial: what is asked of the arm, what the controller did with each state, and how it went."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import MISSING, asdict, dataclass, fields
from enum import IntEnum
from typing import Any, Literal, NamedTuple, Self, TypeVar

import numpy as np

from tel_ros.core.springs import SpringChange, Springs
from tel_ros.core.trajectories.trajectory import DesiredTrajectory, check_points
from tel_ros.core.types import NS_PER_S, BoolArray, FloatArray, IntArray

RecordT = TypeVar("RecordT", bound="TrialReport | LoopTiming")


_SHORTFALL = re.compile(r"(\S+) gives (\S+) of (\S+) N·m")


def shortfall(joint: str, given_nm: float, commanded_nm: float) -> str:
    """Say that a drive gives less than it is commanded, as :attr:`TrialReport.given_nm` reads it."""
    return f"{joint} gives {given_nm:.2f} of {commanded_nm:.2f} N·m"


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

    @property
    def text(self) -> str:
        """The name, as people and ``summary.json`` have it."""
        return self.name.lower()


@dataclass(frozen=True)
class TrialGoal:
    """What to do in one trial; TrajectoryError: the command does not fit the desired trajectory."""

    index: int
    alpha: float
    desired: DesiredTrajectory
    equilibrium_rad: FloatArray
    """The command û at the times of ``desired``. Shape (n, n_joints)."""
    springs: Springs | None = None
    """K and B in this trial; None: as configured."""

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

    def command(self, interface: Literal["effort", "position", "trajectory"]) -> FloatArray:
        """Return what the arm gets: efforts in N·m, or equilibrium points in rad. Shape (n_joints,)."""
        return self.equilibrium_rad if interface == "position" else self.effort_nm


@dataclass(frozen=True, kw_only=True)
class LoopTiming:
    """Figures of one trial, over the joint states that were answered.

    Jitter is the deviation of the time between two arrivals from the period; a response goes from taking a
    state to having sent the command.
    """

    state_rate_hz: float
    """Of the states as they arrived, by the controller's monotonic clock."""
    stamp_rate_hz: float
    """Of the states by their own stamps."""
    jitter_p50_s: float
    jitter_p99_s: float
    jitter_max_s: float
    response_p99_s: float
    response_max_s: float
    missed_ticks: int
    """Periods without an answered state: ``control.loop_timing.missed_ticks``."""
    warning: str = ""
    """What is bad about them, in one line; empty: nothing."""


@dataclass(frozen=True, kw_only=True)
class TrialReport:
    """How one trial went: fields as in ``TrialResult.msg``, with stamps in ns and the timing in one record.

    Errors are measured minus desired position over RUN, NaN if it was not reached. ``timing`` is None if the
    loop was not measured, as in lockstep.
    """

    index: int
    alpha: float
    duration_s: float
    outcome: Outcome
    message: str
    rms_error_rad: float
    rms_error_per_joint_rad: FloatArray
    max_error_rad: float
    max_effort_nm: FloatArray
    saturated_ratio: float
    ticks: int = 0
    timing: LoopTiming | None = None
    start_ns: int = 0
    run_ns: int = 0
    end_ns: int = 0

    @property
    def given_nm(self) -> dict[str, float]:
        """By joint whose drive has given less than commanded: the most that it has given."""
        return {joint: float(given) for joint, given, _ in _SHORTFALL.findall(self.message)}

    def to_plain(self) -> dict[str, Any]:
        """Return what people read, as values that JSON holds: all fields but the stamps. NaN stays NaN."""
        return {
            field.name: _plain(getattr(self, field.name))
            for field in fields(self)
            if not field.name.endswith("_ns")
        }

    @classmethod
    def from_plain(cls, values: Mapping[str, Any]) -> Self:
        """Return the record of plain values, null as NaN; KeyError, TypeError, ValueError: they are none."""
        return _from_plain(cls, values)


def _plain(value: Any) -> Any:
    if isinstance(value, Outcome):
        return value.text
    if isinstance(value, LoopTiming):
        return asdict(value)
    if isinstance(value, np.ndarray):
        return value.tolist()
    return list(value) if isinstance(value, tuple) else value


def _number(value: Any) -> float:
    return math.nan if value is None else float(value)


_READERS: Mapping[str, Callable[[Any], Any]] = {
    "int": int,
    "float": _number,
    "str": lambda value: "" if value is None else str(value),
    "Outcome": lambda value: Outcome[value.upper()],
    "FloatArray": lambda values: np.array([_number(value) for value in values]),
    "tuple[str, ...]": lambda values: tuple(str(value) for value in values),
    "LoopTiming | None": lambda values: None if values is None else _from_plain(LoopTiming, values),
}
"""By the annotation of a field, as it is written."""


def _from_plain(record: type[RecordT], values: Mapping[str, Any]) -> RecordT:
    read = {}
    for field in fields(record):
        if field.name in values or field.default is MISSING:
            reader = _READERS.get(str(field.type), lambda value: value)
            read[field.name] = reader(values[field.name])
    return record(**read)


@dataclass(frozen=True, kw_only=True)
class Trial:
    """What was done in one trial: arrays of shape (n,) or (n, n_joints), with one row a tick."""

    report: TrialReport
    joints: tuple[str, ...]
    """Names, in the order of the columns."""
    time_ns: IntArray
    """Stamps of the joint states that were answered."""
    phase: IntArray
    """Numbers of :class:`Phase`."""
    desired: FloatArray
    """y as positions, velocities, accelerations. Shape (n, 3 * n_joints)."""
    equilibrium_rad: FloatArray
    position_rad: FloatArray
    velocity_rad_s: FloatArray
    effort_nm: FloatArray
    """As commanded, or as expected of position drives."""
    saturated: BoolArray
    """Whether the effort was clipped."""
    springs: SpringChange | None = None
    """Those of the trial, if they were not the configured ones."""

    @property
    def run(self) -> BoolArray:
        """Which ticks belong to RUN. Shape (n,)."""
        run: BoolArray = self.phase == Phase.RUN
        return run

    @property
    def time_s(self) -> FloatArray:
        """Time since the first tick of RUN, or since the first tick if there was none. Shape (n,)."""
        start_ns = self.time_ns[self.run][:1] if self.run.any() else self.time_ns[:1]
        time_s: FloatArray = (self.time_ns - start_ns) / NS_PER_S
        return time_s
