"""What is commanded while an arm is checked, within bounds that every effort passes.

All commands are generators that are sent a state and yield the answer. None of them uses a measured velocity,
or relies on an effort acting on the joint and in the direction that it is meant for: this is to be found out.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Generator
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from tel_ros.core.check.evidence import Heard
from tel_ros.core.config import ArmConfig
from tel_ros.core.errors import ConfigError
from tel_ros.core.types import FloatArray

MOST_EFFORT_SHARE = 0.10
MOST_RANGE_RAD = 0.2
MOST_STATE_GAP_S = 0.1
STATE_GAP_S = 0.07
"""Without a new state for so long everything ends with zero effort, at the drive within 0.1 s."""
FROZEN_S = 0.05
"""States that do not change for so long, though they would have to, end everything as well."""
FROZEN_MEND = "look at the encoders, their bus and the driver: it sends old readings with new stamps"
QUIET_FACTOR, LONGEST_QUIET_S = 4.0, 0.1
"""States that have changed by their noise at least so often do not stand still for four times as long."""
HALF_PULSE_S = 0.05
LONGEST_HALF_PULSE_S = 0.2
"""For joints that the strongest shorter pulse has moved, but not clearly."""
LEFT_ALONE_S = 0.06
BRAKE_S = 0.3
SILENCE_S = 0.16
"""Longer than the 0.1 s after which the effort has to be zero."""
COUNTER_S = 0.3
REST_WINDOW_S = 0.1
_SPEED_WINDOW_S = 0.01
_SAME_S = 1e-6

_T = TypeVar("_T")
Commands = Generator[FloatArray | None, Heard, _T]
"""Yields the effort in answer to the state that it was sent, or None for no command at all. The first one
answers the state that came before."""


@dataclass(frozen=True)
class PulseBounds:
    """What a person has agreed to; raises :class:`ConfigError` beyond what anybody may agree to."""

    effort_share: float = 0.02
    """Largest effort as a share of each joint's limit."""
    range_rad: float = 0.05
    """How far any joint may get from where it was."""

    def __post_init__(self) -> None:
        for option, value, most, unit in (
            ("--effort-share", self.effort_share, MOST_EFFORT_SHARE, ""),
            ("--range", self.range_rad, MOST_RANGE_RAD, " rad"),
        ):
            if not 0.0 < value <= most:  # written so that NaN is refused
                raise ConfigError(option, value, f"above 0 and up to {most}{unit}")


class PulseGuard:
    """Clips every effort, and says when to stop.

    That is when a joint leaves the allowed range about where it was in the state ``home``, when no new state
    comes for ``state_gap_s``, or when the states stand still though they would have to change. Before any
    command nothing in them has changed for ``quiet_s`` at most. Times are those of a clock that only runs
    forward. Raises ConfigError: ``state_gap_s`` is not above 0 and up to :data:`MOST_STATE_GAP_S`.
    """

    def __init__(
        self,
        arm: ArmConfig,
        bounds: PulseBounds,
        home: Heard,
        state_gap_s: float = STATE_GAP_S,
        quiet_s: float = math.inf,
    ) -> None:
        if not 0.0 < state_gap_s <= MOST_STATE_GAP_S:
            raise ConfigError("state_gap_s", state_gap_s, f"above 0 and up to {MOST_STATE_GAP_S} s")
        self._state_gap_s = state_gap_s
        self._quiet_s = max(FROZEN_S, QUIET_FACTOR * quiet_s) if quiet_s <= LONGEST_QUIET_S else math.inf
        self.joints, self.bounds = arm.joints, bounds
        self.most_nm: FloatArray = bounds.effort_share * np.array(arm.effort_limit_nm)
        self._home = self._last = home
        self._ignored = ""
        self._sent_nm = np.zeros_like(self.most_nm)
        self._still_since_s = np.full_like(self.most_nm, home.received_s)
        self._all_still_since_s, self._effort_changed_s = home.received_s, -np.inf
        self.resolution_rad: FloatArray = np.zeros_like(self.most_nm)
        self._follows_nm = np.full_like(self.most_nm, np.inf)
        self.complaint: str | None = None
        """Why everything has to end; stays once it is set."""
        self.mend = ""

    @property
    def away_rad(self) -> FloatArray:
        """How far each joint is from where it was. Shape (n_joints,)."""
        return self._last.position_rad - self._home.position_rad

    def is_new(self, heard: Heard) -> bool:
        """Return whether a state is newer than all before; the others must not be answered."""
        steps_ns = heard.stamp_ns - self._last.stamp_ns
        if steps_ns <= 0:
            self.ignored("their stamp repeats" if steps_ns == 0 else "their stamps have gone back")
        return steps_ns > 0

    def ignored(self, reason: str) -> None:
        """Take in that a joint state came that cannot be used."""
        self._ignored = reason

    def look(self, heard: Heard) -> bool:
        """Take in a new state; return whether to go on."""
        self.look_at_clock(heard.received_s)
        before, self._last, self._ignored = self._last, heard, ""
        told_nm = (heard.effort_nm - self._home.effort_nm) * np.sign(self._sent_nm)
        sent_nm = np.abs(self._sent_nm)
        follows = (sent_nm != 0.0) & (told_nm >= 0.5 * sent_nm) & (told_nm <= 2.0 * sent_nm)
        self._follows_nm[follows] = np.minimum(self._follows_nm, sent_nm)[follows]
        away_rad = np.abs(self.away_rad)
        # Written so that NaN is outside.
        outside = ~(away_rad <= self.bounds.range_rad)
        if np.any(outside):
            j = int(np.argmax(outside))
            away = f"is {away_rad[j]:.4f} rad away from where it was (allowed: {self.bounds.range_rad:g} rad)"
            self.stop(
                f"{self.joints[j]} {away if np.isfinite(away_rad[j]) else 'is at no number of rad'}",
                "are the positions degrees instead of radians? Else less effort (--effort-share), or more "
                "room (--range)",
            )
        self._look_for_frozen(before, heard)
        return self.complaint is None

    def _look_for_frozen(self, before: Heard, heard: Heard) -> None:
        """Stop if values stand still in motion, without their noise, or while the effort changes."""
        same = [
            (now == last) | (np.isnan(now) & np.isnan(last))
            for now, last in zip(heard[3:], before[3:], strict=True)
        ]
        self._still_since_s[~(same[0] & same[1])] = heard.received_s
        if not np.all(same):
            self._all_still_since_s = heard.received_s
        still_s = heard.received_s - self._still_since_s
        # A constant velocity that is there at rest as well is a bias, and a slow joint takes its time from
        # one step of the encoder to the next.
        speed = np.nan_to_num(np.abs(heard.velocity_rad_s - self._home.velocity_rad_s))
        moves = (still_s >= FROZEN_S) & (speed * still_s > np.maximum(4.0 * self.resolution_rad, 2e-4))
        if np.any(moves):
            j = int(np.argmax(moves))
            self.stop_frozen(f"{self.joints[j]} stands still, and is said to move at {speed[j]:.2g} rad/s")
        elif still_s.min() > self._quiet_s:
            self.stop_frozen("their noise has gone")
        elif self._all_still_since_s <= self._effort_changed_s <= heard.received_s - FROZEN_S:
            self.stop_frozen("no value has changed with the effort")

    def stop_frozen(self, how: str) -> None:
        """End everything because readings are frozen."""
        self.stop(f"the joint states are frozen, though their stamps go on: {how}", FROZEN_MEND)

    def look_at_clock(self, now_s: float) -> bool:
        """Take in that time has passed; return whether to go on."""
        if not now_s - self._last.received_s <= self._state_gap_s:
            reason = f"no joint state for {self._state_gap_s:g} s"
            mend = "the driver has stopped, or this machine is too busy: see rate and jitter"
            if self._ignored:
                reason = f"no new joint state for {self._state_gap_s:g} s: {self._ignored}"
                mend = "look at the driver and the publisher of the joint states"
            self.stop(reason, mend)
        return self.complaint is None

    def stop(self, reason: str, mend: str) -> None:
        """End everything for a reason that can be mended; the first one counts."""
        if self.complaint is None:
            self.complaint, self.mend = reason, mend

    def allowed(self, effort_nm: FloatArray) -> FloatArray:
        """Return an effort that may be sent: zero after a complaint or if it is not finite, else clipped."""
        sent_nm = np.zeros_like(self.most_nm)
        if self.complaint is None and np.isfinite(effort_nm).all():
            sent_nm = np.clip(effort_nm, -self.most_nm, self.most_nm)
        if np.any(np.abs(sent_nm - self._sent_nm) >= self._follows_nm):
            self._effort_changed_s = self._last.received_s
        self._sent_nm = sent_nm
        return sent_nm


class Course:
    """Answers an arm state by state, until its commands end or the guard says so: then with zero effort."""

    def __init__(self, guard: PulseGuard, commands: Commands[object]) -> None:
        self.guard, self._commands, self.done = guard, commands, False
        next(commands)

    def step(self, heard: Heard) -> FloatArray | None:
        """Return the effort to send for a state that has arrived, or None for no command at all."""
        if not self.guard.is_new(heard):
            return self.watch(heard.received_s)
        if not self.guard.look(heard):
            return self._end()
        try:
            effort_nm = self._commands.send(heard)
        except StopIteration:
            return self._end()
        if self.guard.complaint is not None:
            return self._end()
        return None if effort_nm is None else self.guard.allowed(effort_nm)

    def watch(self, now_s: float) -> FloatArray | None:
        """Take in that time passes without states; return an effort to send at once, if any."""
        return None if self.done or self.guard.look_at_clock(now_s) else self._end()

    def _end(self) -> FloatArray:
        self.done = True
        self._commands.close()
        return np.zeros_like(self.guard.most_nm)


def doublet(
    guard: PulseGuard, joint: int, effort_nm: float, enough_rad: float, half_s: float = HALF_PULSE_S
) -> Commands[tuple[float, float, float, float]]:
    """Command an effort one way, then the other way for as long, then zero effort for a moment.

    The two halves leave no momentum behind, in any joint, whatever joint they act on and in whatever
    direction: unlike a damper, that is a brake that needs no right sign. The first half ends after
    ``half_s``, or early when any joint has gone ``enough_rad``. Returns when it started, turned, went to zero
    and ended.
    """
    push = _on_one(guard, joint, effort_nm)
    heard = yield 0.0 * push
    start_s, from_rad = heard.received_s, heard.position_rad
    heard = yield push
    # The tolerance keeps rounding of equal periods from adding one.
    while heard.received_s - start_s < half_s - _SAME_S:
        if np.abs(heard.position_rad - from_rad).max() >= enough_rad:
            break
        heard = yield push
    turn_s = heard.received_s
    # A state that came late has made the first half longer, but never the second beyond its limit.
    while heard.received_s - turn_s < min(turn_s - start_s, half_s) - _SAME_S:
        heard = yield -push
    zero_s = heard.received_s
    while heard.received_s - zero_s < LEFT_ALONE_S:
        heard = yield 0.0 * push
    return start_s, turn_s, zero_s, heard.received_s


def come_to_rest(
    guard: PulseGuard,
    damping_nms_per_rad: FloatArray,
    most_nm: float,
    rest_rad: FloatArray,
    timeout_s: float = 3.0,
    window_s: float = REST_WINDOW_S,
) -> Commands[None]:
    """Command zero effort until the arm rests, after -B q̇ on joints that obey (B is 0 for others).

    The damper never exerts more than ``most_nm``, ends when the joint turns round, and after :data:`BRAKE_S`
    in any case. The speed is computed from positions. A joint is at rest that goes no further than
    ``rest_rad`` within ``window_s``, noise averaged out; if one does not come to rest in time, everything
    ends.
    """
    heard = yield np.zeros_like(rest_rad)
    start_s, way = heard.received_s, np.full_like(rest_rad, np.nan)
    history = deque([heard])
    while True:
        waited_s, effort = heard.received_s - start_s, np.zeros_like(rest_rad)
        while heard.received_s - history[0].received_s > window_s:
            history.popleft()
        if waited_s >= window_s:
            pieces = np.array_split([past.position_rad for past in history], 10)
            went_rad = np.ptp([np.mean(piece, axis=0) for piece in pieces if len(piece)], axis=0)
            if np.all(went_rad <= rest_rad):
                return
            if waited_s > timeout_s:
                guard.stop(
                    f"{guard.joints[int(np.argmax(went_rad - rest_rad))]} does not come to rest without "
                    f"effort within {timeout_s:g} s",
                    "support an arm that cannot rest without effort, let the drive compensate gravity, or "
                    "use --passive",
                )
        past = next(
            (p for p in reversed(history) if heard.received_s - p.received_s >= _SPEED_WINDOW_S), None
        )
        if past is not None and waited_s <= BRAKE_S:
            speed = (heard.position_rad - past.position_rad) / (heard.received_s - past.received_s)
            way = np.where(np.isnan(way), np.sign(speed), np.where(speed * way >= 0.0, way, 0.0))
            effort = np.clip(np.where(way != 0.0, -damping_nms_per_rad * speed, 0.0), -most_nm, most_nm)
        heard = yield effort
        history.append(heard)


def fall_silent(guard: PulseGuard, joint: int, effort_nm: float, times_s: list[float]) -> Commands[None]:
    """Command a constant effort, nothing for :data:`SILENCE_S`, then the opposite until the joint stops.

    The last part needs no right sign either: what stops the joint stops what moves along with it. Adds to
    ``times_s`` when it started, of the last command and of the end of the silence.
    """
    push = _on_one(guard, joint, effort_nm)
    heard = yield 0.0 * push
    start_s = silent_s = heard.received_s
    while heard.received_s - start_s < HALF_PULSE_S:
        silent_s = heard.received_s
        heard = yield push
    while heard.received_s - silent_s < SILENCE_S:
        heard = yield None
    times_s += [start_s, silent_s, heard.received_s]
    last, way = heard, 0.0
    while heard.received_s - times_s[-1] <= COUNTER_S:
        if heard.received_s - last.received_s >= _SPEED_WINDOW_S:
            moved = np.sign(heard.position_rad[joint] - last.position_rad[joint])
            last = heard
            if moved * way < 0.0:  # no motion at all is less than a step of the encoder
                return
            way = way or moved
        heard = yield -push


def _on_one(guard: PulseGuard, joint: int, effort_nm: float) -> FloatArray:
    effort = np.zeros_like(guard.most_nm)
    effort[joint] = effort_nm
    return effort
