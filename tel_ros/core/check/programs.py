"""What is commanded while an arm is checked: one program after the other, each fed state by state.

None of them uses a measured velocity or trusts that an effort acts on the joint, or in the direction, that it
is meant for: this is what is to be found out.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque

import numpy as np

from tel_ros.core.check.bounds import Guard
from tel_ros.core.types import FloatArray

HALF_PULSE_S = 0.05
LEFT_ALONE_S = 0.06
BRAKE_S = 0.3
SILENCE_S = 0.16
"""Longer than the 0.1 s after which the effort has to be zero."""
COUNTER_S = 0.3
REST_WINDOW_S = 0.1
_SPEED_WINDOW_S = 0.01
_SAME_S = 1e-6


class Program(ABC):
    """Something to command; ``done`` after a while in any case.

    Args:
        guard: has the last word on every effort.
    """

    def __init__(self, guard: Guard) -> None:
        self.guard = guard
        self.done = False

    def step(self, now_s: float, position_rad: FloatArray) -> FloatArray | None:
        """Return the effort to send now, or None for no command at all.

        Args:
            now_s: when the state arrived, on a clock that only runs forward.
            position_rad: shape (n_joints,).
        """
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
        """Return the effort for a state that the guard has nothing against."""

    def _on_one(self, joint: int, effort_nm: float) -> FloatArray:
        effort = np.zeros_like(self.guard.most_nm)
        effort[joint] = effort_nm
        return effort


class Doublet(Program):
    """An effort one way, then the other way for as long, then nothing for a moment.

    The two halves leave no momentum behind, in any joint, whatever joint they act on and in whatever
    direction: unlike a damper, that is a brake that needs no right sign. The first half ends early when any
    joint has gone ``enough_rad``.
    """

    def __init__(self, guard: Guard, joint: int, effort_nm: float, enough_rad: float) -> None:
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
    """Zero effort until the arm rests, after -B q̇ on joints that are known to obey.

    The damper never exerts more than the pulse did, ends when the joint turns round, and after
    :data:`BRAKE_S` in any case. The speed is made of positions.

    Args:
        guard: has the last word.
        damping_nms_per_rad: B of joints that have moved the way they were pushed, 0 for others.
        most_nm: largest effort of the damper.
        rest_rad: how far a joint may go within :data:`REST_WINDOW_S` and count as at rest.
        timeout_s: then everything ends.
    """

    def __init__(
        self,
        guard: Guard,
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
            positions = np.array([position for _, position in self._history])
            if np.all(np.ptp(positions, axis=0) <= self._rest_rad):
                self.done = True
            elif waited_s > self._timeout_s:
                j = int(np.argmax(np.ptp(positions, axis=0) - self._rest_rad))
                self.guard.stop(
                    f"{self.guard.joints[j]} does not come to rest without effort within "
                    f"{self._timeout_s:g} s",
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

    def __init__(self, guard: Guard, joint: int, effort_nm: float) -> None:
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
