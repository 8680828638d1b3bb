"""The gate for joint states: numbers and arrival in, a state of the arm or the reason of a refusal out."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from tel_ros.core.arm_state import ArmState
from tel_ros.core.config import ArmConfig, ControlConfig
from tel_ros.core.errors import StateError
from tel_ros.core.types import NS_PER_S, FloatArray

TIMES_THE_LIMIT = 10.0
"""A trial is aborted at the velocity limit itself; what is so far above it is no motion. Nor is a jump that
takes so many times the speed that the states tell."""
SMALL_JUMP_RAD = 0.1
"""Smaller jumps are left to the rules about motion: coarse encoders make small ones."""


class StateGate:
    """Judges each joint state, and picks the arm's joints out of it by name.

    Refused are states that lack a joint or are malformed, that a newer one has overtaken, that no arm can be
    in (:class:`Plausibility`), and that are not finite. A refused state is to be passed over, as if it had
    got lost. A state that is sent again (same stamp) gives the same object again: it says nothing new.

    Velocities that the arm does not report are estimated (:class:`MissingVelocities`), and how late a state
    is, is told by its arrival (:class:`Latency`).

    The arm's velocity limits must have been filled from the URDF. Without ``clock_drift`` no state is late.
    """

    def __init__(self, arm: ArmConfig, control: ControlConfig, clock_drift: float | None = None) -> None:
        self._joints = list(arm.joints)
        self._timeout_ns = round(control.state_timeout_s * NS_PER_S)
        self._plausibility = Plausibility(arm.joints, np.array(arm.velocity_limit_rad_s), self._timeout_ns)
        self._velocities = MissingVelocities(
            len(arm.joints), cutoff_hz=control.velocity_filter_hz, max_gap_s=control.state_timeout_s
        )
        self._latency = None if clock_drift is None else Latency(clock_drift)
        self._newest_ns: int | None = None
        self.newest: ArmState | None = None
        """The last state that was admitted; None: none was."""
        self._names: Sequence[str] | None = None
        self._columns: list[int] | slice = slice(None)

    @property
    def estimated(self) -> tuple[str, ...]:
        """Joints whose velocity is estimated at present."""
        indices = self._velocities.estimated
        return tuple(self._joints[k] for k in indices) if indices else ()

    def admit(
        self,
        names: Sequence[str],
        stamp_ns: int,
        positions_rad: Sequence[float],
        velocities_rad_s: Sequence[float],
        efforts_nm: Sequence[float],
        arrived_ns: int,
    ) -> ArmState:
        """Return the state of the arm's joints; StateError: it is refused, and why.

        The fields are in the order of the names. Velocities and efforts that are not reported are NaN or
        missing; a list of efforts of another length counts as missing. ``stamp_ns`` is by the clock of the
        arm, ``arrived_ns`` by one of this machine that nobody sets.
        """
        if names is not self._names:
            self._find_columns(names)
        n = len(names)
        if len(positions_rad) != n or len(velocities_rad_s) not in (n, 0):
            raise StateError(
                f"the joint state has {n} names, {len(positions_rad)} positions and "
                f"{len(velocities_rad_s)} velocities; expected as many of each, or no velocities"
            )
        self._require_in_order(stamp_ns)
        if self.newest is not None and self.newest.time_ns == stamp_ns:
            return self.newest
        columns = self._columns
        position_rad = np.array(positions_rad)[columns]
        if velocities_rad_s:
            velocity_rad_s = np.array(velocities_rad_s)[columns]
        else:
            velocity_rad_s = np.full(len(self._joints), np.nan)
        self._plausibility.require(stamp_ns, position_rad, velocity_rad_s)
        velocity_rad_s = self._velocities.fill(stamp_ns, position_rad, velocity_rad_s)
        effort_nm = np.array(efforts_nm)[columns] if len(efforts_nm) == n else None
        age_s = 0.0 if self._latency is None else self._latency.of(stamp_ns, arrived_ns)
        estimated = bool(self._velocities.estimated)
        self.newest = ArmState(stamp_ns, position_rad, velocity_rad_s, age_s, effort_nm, estimated)
        return self.newest

    def _find_columns(self, names: Sequence[str]) -> None:
        missing = [joint for joint in self._joints if joint not in names]
        if missing:
            found = ", ".join(names) or "no joints"
            raise StateError(f"the joint state has {found}; expected also {', '.join(missing)}")
        columns = [names.index(joint) for joint in self._joints]
        self._columns = slice(None) if columns == list(range(len(names))) else columns
        self._names = names

    def _require_in_order(self, stamp_ns: int) -> None:
        """Refuse a state that a newer one has overtaken, and remember the newest stamp.

        An overtaken state says nothing about now: a damper that answers it brakes a speed of before, which
        drives light joints beyond their limits within a few periods. Stamps that go back by the time-out or
        more are of a clock that was set; they count from then on. Where a clock was set back by less, states
        are refused until it has caught up: for less than the time-out, then.
        """
        newest_ns = self._newest_ns
        if newest_ns is not None and 0 < newest_ns - stamp_ns < self._timeout_ns:
            raise StateError(
                f"the joint state is {(newest_ns - stamp_ns) / NS_PER_S:.3f} s older than one that came "
                "before it"
            )
        self._newest_ns = stamp_ns


class Plausibility:
    """Refuses states in which a joint is many times faster than it may be, or has jumped.

    Such a number comes from a broken message or a sensor that slipped. A damper that answers it kicks with
    all the effort that there is, before anything else can notice: it brakes a speed that is not there. Where
    such states go on, that ends in a loss of the states. A position that stays elsewhere is believed once no
    other has come for the time-out. Velocity limits may be infinite.
    """

    def __init__(self, joints: Sequence[str], velocity_limit_rad_s: FloatArray, timeout_ns: int) -> None:
        self._joints = tuple(joints)
        self._limit_rad_s = velocity_limit_rad_s
        self._fastest_rad_s = TIMES_THE_LIMIT * velocity_limit_rad_s
        self._timeout_ns = timeout_ns
        self._last_ns: int | None = None
        self._position_rad = self._velocity_rad_s = np.zeros(len(joints))
        self._positions, self._fastest = self._position_rad.tolist(), self._fastest_rad_s.tolist()

    def require(self, time_ns: int, position_rad: FloatArray, velocity_rad_s: FloatArray) -> None:
        """Refuse a state, or remember it as the last one. Shapes (n_joints,).

        Numbers that are not finite are not judged here; velocities are NaN where none is reported. Raises
        StateError: a joint is too fast, or has jumped.
        """
        positions = position_rad.tolist()
        if self._last_ns is None or not self._is_ordinary(positions, velocity_rad_s.tolist()):
            self._judge(time_ns, position_rad, velocity_rad_s)
            if not np.isfinite(position_rad.sum()):
                return
        self._last_ns, self._position_rad, self._velocity_rad_s = time_ns, position_rad, velocity_rad_s
        self._positions = positions

    def _is_ordinary(self, positions: list[float], velocities: list[float]) -> bool:
        """Return whether no joint is too fast or has moved far: in the control loop this has to be quick."""
        for q, last, v, fastest in zip(positions, self._positions, velocities, self._fastest, strict=True):
            if not (-SMALL_JUMP_RAD <= q - last <= SMALL_JUMP_RAD and -fastest <= v <= fastest):
                return False  # or something is NaN
        return True

    def _judge(self, time_ns: int, position_rad: FloatArray, velocity_rad_s: FloatArray) -> None:
        told_rad_s = np.abs(velocity_rad_s)
        self._require_below(told_rad_s, self._fastest_rad_s, "moves at {:.6g} rad/s", "its velocity limit")
        last_ns = self._last_ns
        if last_ns is not None and 0 < time_ns - last_ns <= self._timeout_ns:
            # The limit itself where no speed is told, or a higher one.
            speed_rad_s = np.fmin(told_rad_s, self._limit_rad_s)
            before_rad_s = np.fmin(np.abs(self._velocity_rad_s), self._limit_rad_s)
            step_s = TIMES_THE_LIMIT * (time_ns - last_ns) / NS_PER_S
            furthest_rad = SMALL_JUMP_RAD + step_s * np.maximum(speed_rad_s, before_rad_s)
            jump_rad = np.abs(position_rad - self._position_rad)
            self._require_below(jump_rad, furthest_rad, "has jumped by {:.6g} rad", "what its speed explains")

    def _require_below(self, found: FloatArray, most: FloatArray, what: str, measure: str) -> None:
        beyond = found > most
        if beyond.any():
            j = int(np.argmax(beyond))
            raise StateError(
                f"the joint state says that {self._joints[j]} {what.format(found[j])}; expected at most "
                f"{most[j]:.6g} ({TIMES_THE_LIMIT:g} times {measure})"
            )


class Latency:
    """Tells by how much longer than the fastest ones a state was on its way.

    The difference between arrival and stamp is the time on the way plus a constant, by which the two clocks
    differ. Its minimum so far belongs to the fastest state; what a state has more than that is its latency.
    After a stamp that goes back (a clock that was set, another source) the minimum counts anew.

    Clocks drift, and a minimum that never rose would take a slow clock for states that come later and later.
    So it rises by a share of the time that passes. A latency that grows no faster than that goes unseen, and
    one that stays is forgotten at that rate. ``clock_drift``: the share, 0 to 1. With 1 nothing is ever late,
    whatever the stamps do.
    """

    def __init__(self, clock_drift: float) -> None:
        self._clock_drift = clock_drift
        self._least_ns = 0
        self._stamp_ns: int | None = None
        self._arrived_ns = 0

    def of(self, stamp_ns: int, arrived_ns: int) -> float:
        """Take in a state and return how late it is, in s, at least 0."""
        offset_ns = arrived_ns - stamp_ns
        if self._stamp_ns is None or stamp_ns < self._stamp_ns:
            self._least_ns = offset_ns
        else:
            risen_ns = self._least_ns + round(self._clock_drift * (arrived_ns - self._arrived_ns))
            self._least_ns = min(risen_ns, offset_ns)
        self._stamp_ns, self._arrived_ns = stamp_ns, arrived_ns
        return (offset_ns - self._least_ns) / NS_PER_S


class MissingVelocities:
    """Estimates the velocities that an arm does not report: differences through a first-order low-pass.

    v ← v + (1 − exp(−2π f Δt)) ((q − q_last) / Δt − v): the low-pass solved exactly for an input that is
    constant between two stamps, so that it is stable for every corner frequency f and every Δt. It looks back
    only, as the control loop has to. The price is a lag: at a constant acceleration the estimate is late by
    Δt/2 for the difference and Δt / (exp(2π f Δt) − 1) for the low-pass; 1.8 ms in all with 500 Hz and
    f = 100 Hz. An encoder step of s rad shows up as a velocity of at most s (1 − exp(−2π f Δt)) / Δt:
    0.034 rad/s with 16 bits, but 0.55 rad/s with 12.

    After a start, a gap or stamps that went back the velocity is unknown: 0 at the first position, and the
    plain difference at the second.

    A joint whose velocity is NaN reports none (the stock ``joint_state_broadcaster`` does so). A joint that
    has reported its velocity once is never estimated again: NaN is a fault there, and handed on as such.

    Positions that are further apart than ``max_gap_s`` do not belong to one movement.
    """

    def __init__(self, n_joints: int, *, cutoff_hz: float, max_gap_s: float) -> None:
        self._rate_rad_s = 2.0 * math.pi * cutoff_hz
        self._max_gap_ns = round(max_gap_s * NS_PER_S)
        self._last_ns: int | None = None
        self._position_rad = self._velocity_rad_s = np.zeros(n_joints)
        self._has_difference = False
        self._told = np.zeros(n_joints, dtype=bool)
        self._all_told = False
        self.estimated: tuple[int, ...] = ()
        """Which joints are estimated at present, by index."""

    def fill(self, time_ns: int, position_rad: FloatArray, velocity_rad_s: FloatArray) -> FloatArray:
        """Return velocities as reported, NaN replaced by estimates. Shapes (n_joints,).

        Raises StateError: velocities are missing, and a position is not finite; it is not taken in.
        """
        if self._all_told:
            return velocity_rad_s
        self._told = self._told | np.isfinite(velocity_rad_s)
        self._all_told = bool(self._told.all())
        self.estimated = tuple(np.flatnonzero(~self._told).tolist())
        if self._all_told:
            return velocity_rad_s
        if not np.isfinite(position_rad.sum()):
            raise StateError(f"the positions are {position_rad.tolist()} rad; expected finite numbers")
        self._estimate(time_ns, position_rad)
        return np.where(np.isnan(velocity_rad_s) & ~self._told, self._velocity_rad_s, velocity_rad_s)

    def _estimate(self, time_ns: int, position_rad: FloatArray) -> None:
        step_ns = -1 if self._last_ns is None else time_ns - self._last_ns
        if step_ns == 0:
            return  # the state was sent again
        if 0 < step_ns <= self._max_gap_ns:
            step_s = step_ns / NS_PER_S
            difference_rad_s = (position_rad - self._position_rad) / step_s
            share = -math.expm1(-self._rate_rad_s * step_s) if self._has_difference else 1.0
            self._velocity_rad_s = self._velocity_rad_s + share * (difference_rad_s - self._velocity_rad_s)
            self._has_difference = True
        else:
            self._velocity_rad_s = np.zeros(len(position_rad))
            self._has_difference = False
        self._last_ns, self._position_rad = time_ns, position_rad.copy()
