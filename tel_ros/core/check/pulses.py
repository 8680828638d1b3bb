"""What is commanded while an arm is checked, within bounds that every effort passes.

One program runs after the other, each fed state by state. None of them uses a measured velocity, or relies on
an effort acting on the joint and in the direction that it is meant for: this is what is to be found out.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque
from dataclasses import dataclass

import numpy as np

from tel_ros.core.config import ArmConfig
from tel_ros.core.errors import ConfigError
from tel_ros.core.types import FloatArray

MOST_EFFORT_SHARE = 0.10
MOST_RANGE_RAD = 0.2
MOST_STATE_GAP_S = 0.1
"""Without a state for at most this long everything ends with zero effort."""
HALF_PULSE_S = 0.05
LEFT_ALONE_S = 0.06
BRAKE_S = 0.3
SILENCE_S = 0.16
"""Longer than the 0.1 s after which the effort has to be zero."""
COUNTER_S = 0.3
REST_WINDOW_S = 0.1
_SPEED_WINDOW_S = 0.01
_SAME_S = 1e-6


@dataclass(frozen=True)
class PulseBounds:
    """What a person has agreed to; raises :class:`ConfigError` beyond what anybody may agree to."""

    effort_share: float = 0.02
    """Largest effort as a share of each joint's limit."""
    range_rad: float = 0.05
    """How far any joint may get from where it was."""

    def __post_init__(self) -> None:
        for key, most, unit in (
            ("effort_share", MOST_EFFORT_SHARE, ""),
            ("range_rad", MOST_RANGE_RAD, " rad"),
        ):
            value = getattr(self, key)
            if not 0.0 < value <= most:  # written so that NaN is refused
                raise ConfigError(key, value, f"above 0 and up to {most}{unit}")


class PulseGuard:
    """Clips every effort, and says when to stop.

    That is when a joint leaves the allowed range about ``position_rad``, where the arm is now, or when no
    state comes for ``state_gap_s``. Times are those of a clock that only runs forward.

    Raises:
        ConfigError: ``state_gap_s`` is not above 0 and up to :data:`MOST_STATE_GAP_S`.
    """

    def __init__(
        self,
        arm: ArmConfig,
        bounds: PulseBounds,
        position_rad: FloatArray,
        now_s: float,
        state_gap_s: float = MOST_STATE_GAP_S,
    ) -> None:
        if not 0.0 < state_gap_s <= MOST_STATE_GAP_S:
            raise ConfigError("state_gap_s", state_gap_s, f"above 0 and up to {MOST_STATE_GAP_S} s")
        self._state_gap_s = state_gap_s
        self.joints, self.bounds = arm.joints, bounds
        self.most_nm: FloatArray = bounds.effort_share * np.array(arm.effort_limit_nm)
        self.home_rad: FloatArray = position_rad.copy()
        self._seen_s = now_s
        self.complaint: str | None = None
        """Why everything has to end; stays once it is set."""
        self.mend = ""

    def look(self, now_s: float, position_rad: FloatArray) -> bool:
        """Take in a state; return whether to go on."""
        self.look_at_clock(now_s)
        self._seen_s = now_s
        away_rad = np.abs(position_rad - self.home_rad)
        # Written so that NaN is outside.
        outside = ~(away_rad <= self.bounds.range_rad)
        if self.complaint is None and np.any(outside):
            j = int(np.argmax(outside))
            self.stop(
                f"{self.joints[j]} is {away_rad[j]:.4f} rad away from where it was "
                f"(allowed: {self.bounds.range_rad:g} rad)",
                "are the positions degrees instead of radians? Else less effort (--effort-share), or more "
                "room (--range)",
            )
        return self.complaint is None

    def look_at_clock(self, now_s: float) -> bool:
        """Take in that time has passed; return whether to go on."""
        if self.complaint is None and not now_s - self._seen_s <= self._state_gap_s:
            self.stop(
                f"no joint state for {self._state_gap_s:g} s",
                "the driver has stopped, or this machine is too busy: see rate and jitter",
            )
        return self.complaint is None

    def stop(self, reason: str, mend: str) -> None:
        """End everything for a reason that can be mended; the first one counts."""
        if self.complaint is None:
            self.complaint, self.mend = reason, mend

    def allowed(self, effort_nm: FloatArray) -> FloatArray:
        """Return an effort that may be sent: zero after a complaint or if it is not finite, else clipped."""
        if self.complaint is not None or not np.isfinite(effort_nm).all():
            return np.zeros_like(self.most_nm)
        return np.asarray(np.clip(effort_nm, -self.most_nm, self.most_nm), dtype=np.float64)


class Program(ABC):
    """Something to command, ``done`` after a while in any case; the guard has the last word on efforts."""

    def __init__(self, guard: PulseGuard) -> None:
        self.guard = guard
        self.done = False

    def step(self, now_s: float, position_rad: FloatArray) -> FloatArray | None:
        """Return the effort to send for a state that has arrived now, or None for no command at all."""
        if not self.guard.look(now_s, position_rad):
            self.done = True
            return np.zeros_like(self.guard.most_nm)
        effort_nm = self._effort(now_s, position_rad)
        return None if effort_nm is None else self.guard.allowed(effort_nm)

    def watch(self, now_s: float) -> FloatArray | None:
        """Take in that time passes without states; return an effort to send at once, if any."""
        if self.done or self.guard.look_at_clock(now_s):
            return None
        self.done = True
        return np.zeros_like(self.guard.most_nm)

    @abstractmethod
    def _effort(self, now_s: float, position_rad: FloatArray) -> FloatArray | None:
        """Return the effort for a state that the guard accepts."""

    def _on_one(self, joint: int, effort_nm: float) -> FloatArray:
        effort = np.zeros_like(self.guard.most_nm)
        effort[joint] = effort_nm
        return effort


class Doublet(Program):
    """An effort one way, then the other way for as long, then zero effort for a moment.

    The two halves leave no momentum behind, in any joint, whatever joint they act on and in whatever
    direction: unlike a damper, that is a brake that needs no right sign. The first half ends early when any
    joint has gone ``enough_rad``.
    """

    def __init__(self, guard: PulseGuard, joint: int, effort_nm: float, enough_rad: float) -> None:
        super().__init__(guard)
        self.joint, self.effort_nm, self._enough_rad = joint, effort_nm, enough_rad
        self.start_s = self.turn_s = self.zero_s = self.end_s = np.nan
        self._from_rad: FloatArray | None = None

    def _effort(self, now_s: float, position_rad: FloatArray) -> FloatArray:
        if self._from_rad is None:
            self.start_s, self._from_rad = now_s, position_rad.copy()
        if np.isnan(self.turn_s):
            went_rad = np.abs(position_rad - self._from_rad).max()
            # The tolerance keeps rounding of equal periods from adding one.
            more = now_s - self.start_s < HALF_PULSE_S - _SAME_S
            if more and (went_rad < self._enough_rad or now_s == self.start_s):
                return self._on_one(self.joint, self.effort_nm)
            self.turn_s = now_s
        if np.isnan(self.zero_s):
            # A state that came late has made the first half longer, but never the second beyond its limit.
            if now_s - self.turn_s < min(self.turn_s - self.start_s, HALF_PULSE_S) - _SAME_S:
                return self._on_one(self.joint, -self.effort_nm)
            self.zero_s = now_s
        if now_s - self.zero_s >= LEFT_ALONE_S:
            self.end_s, self.done = now_s, True
        return np.zeros_like(position_rad)


class ComeToRest(Program):
    """Zero effort until the arm rests, after -B q̇ on joints that are known to obey (B is 0 for others).

    The damper never exerts more than ``most_nm``, ends when the joint turns round, and after :data:`BRAKE_S`
    in any case. The speed is computed from positions. A joint is at rest that goes no further than
    ``rest_rad`` within :data:`REST_WINDOW_S`; if one does not come to rest in time, everything ends.
    """

    def __init__(
        self,
        guard: PulseGuard,
        damping_nms_per_rad: FloatArray,
        most_nm: float,
        rest_rad: FloatArray,
        timeout_s: float = 3.0,
    ) -> None:
        super().__init__(guard)
        self._damping, self._most_nm = damping_nms_per_rad, most_nm
        self._rest_rad, self._timeout_s = rest_rad, timeout_s
        self._start_s: float | None = None
        self._way: FloatArray | None = None
        self._history: deque[tuple[float, FloatArray]] = deque()

    def _effort(self, now_s: float, position_rad: FloatArray) -> FloatArray:
        self._start_s = now_s if self._start_s is None else self._start_s
        self._history.append((now_s, position_rad.copy()))
        while now_s - self._history[0][0] > REST_WINDOW_S:
            self._history.popleft()
        waited_s = now_s - self._start_s
        if waited_s >= REST_WINDOW_S:
            went_rad = np.ptp(np.array([position for _, position in self._history]), axis=0)
            if np.all(went_rad <= self._rest_rad):
                self.done = True
            elif waited_s > self._timeout_s:
                joint = self.guard.joints[int(np.argmax(went_rad - self._rest_rad))]
                self.guard.stop(
                    f"{joint} does not come to rest without effort within {self._timeout_s:g} s",
                    "support an arm that cannot rest without effort, let the drive compensate gravity, or "
                    "use --passive",
                )
                self.done = True
        if waited_s > BRAKE_S or self.done:
            return np.zeros_like(position_rad)
        return self._brake(now_s, position_rad)

    def _brake(self, now_s: float, position_rad: FloatArray) -> FloatArray:
        past = [entry for entry in self._history if now_s - entry[0] >= _SPEED_WINDOW_S]
        if not past:
            return np.zeros_like(position_rad)
        before_s, before_rad = past[-1]
        speed = (position_rad - before_rad) / (now_s - before_s)
        if self._way is None:
            self._way = np.sign(speed)
        self._way = np.where(speed * self._way > 0.0, self._way, 0.0)
        effort = np.where(self._way != 0.0, -self._damping * speed, 0.0)
        return np.asarray(np.clip(effort, -self._most_nm, self._most_nm), dtype=np.float64)


class FallSilent(Program):
    """A constant effort, no commands for :data:`SILENCE_S`, then the opposite effort until the joint stops.

    The last part needs no right sign either: what stops the joint stops what moves along with it.
    """

    def __init__(self, guard: PulseGuard, joint: int, effort_nm: float) -> None:
        super().__init__(guard)
        self.joint, self.effort_nm = joint, effort_nm
        self.start_s = self.silent_s = self.end_s = np.nan
        self._last: tuple[float, float] | None = None
        self._way = 0.0

    def _effort(self, now_s: float, position_rad: FloatArray) -> FloatArray | None:
        if np.isnan(self.start_s):
            self.start_s = now_s
        if now_s - self.start_s < HALF_PULSE_S:
            self.silent_s = now_s
            return self._on_one(self.joint, self.effort_nm)
        if now_s - self.silent_s < SILENCE_S:
            return None
        if np.isnan(self.end_s):
            self.end_s = now_s
        return self._counter(now_s, float(position_rad[self.joint]))

    def _counter(self, now_s: float, position_rad: float) -> FloatArray:
        if self._last is None:
            self._last = (now_s, position_rad)
        if now_s - self._last[0] >= _SPEED_WINDOW_S:
            way = np.sign(position_rad - self._last[1])
            self._last = (now_s, position_rad)
            if self._way and way != self._way:
                self.done = True
            self._way = self._way or way or 1.0
        self.done = self.done or now_s - self.end_s > COUNTER_S
        if self.done:
            return np.zeros_like(self.guard.most_nm)
        return self._on_one(self.joint, -self.effort_nm)
