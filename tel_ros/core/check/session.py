"""The order of the pulses: from the weakest on, joint by joint, there and back."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from tel_ros.core.check.evidence import Pulse, Pulsed, Silence, StateRecord, UrdfModel
from tel_ros.core.check.pulses import (
    HALF_PULSE_S,
    LONGEST_HALF_PULSE_S,
    SILENCE_S,
    Commands,
    Course,
    PulseGuard,
    come_to_rest,
    doublet,
    fall_silent,
)
from tel_ros.core.check.response import expected_reach_rad, unsound
from tel_ros.core.types import FloatArray

LEVELS = (1 / 16, 1 / 8, 1 / 4, 1 / 2, 1.0)
"""Shares of the largest effort that are tried, until a joint moves clearly."""
LONGER_S = (2.0 * HALF_PULSE_S, LONGEST_HALF_PULSE_S)
"""For how long the largest one is tried after that, on a joint that it has moved a little."""
# Shares of the allowed range:
VISIBLE_SHARE = 0.008  # a joint has moved so far that it can be judged
CLEAR_SHARE = 0.04  # it has moved so clearly that no stronger pulse is needed
TURN_SHARE = 0.1  # a pulse turns round early
FURTHEST_SHARE = 0.6  # where a pulse has to have ended; it goes as far again after its turn as before
SILENCE_SHARE = 0.15  # the test of the watchdog may use it if there is none
VISIBLE_STEPS = 4.0
CLEAR_STEPS = 12.0
"""The same in steps of the encoder, where they are more."""
FIRST_REST_S = 0.3
_BEFORE_S = 0.03

States = Callable[[float], StateRecord]


class PulseSession:
    """Commands the pulses and keeps what they show; brakes with B, the damping.

    ``states`` returns what has arrived since a time. It is asked while the arm waits, so it has to be quick.
    """

    def __init__(
        self,
        guard: PulseGuard,
        damping_nms_per_rad: FloatArray,
        resolution_rad: FloatArray,
        states: States,
        model: UrdfModel,
    ) -> None:
        self._guard, self._damping, self._states, self._model = guard, damping_nms_per_rad, states, model
        self._noise_rad = resolution_rad
        self._refine(resolution_rad)
        self.pulses: list[Pulse] = []
        """The strongest pair of pulses of each joint."""
        self.silence: Silence | None = None
        self._lively: Pulse | None = None

    def course(self) -> Course:
        """Return the answers to the arm's states from now on."""
        return Course(self._guard, self._commands())

    def _commands(self) -> Commands[None]:
        nothing = np.zeros_like(self._damping)
        yield from come_to_rest(self._guard, nothing, 0.0, self._rest_rad, window_s=FIRST_REST_S)
        for joint in range(len(self._damping)):
            pair: list[Pulse] = []
            for level, half_s in [(level, HALF_PULSE_S) for level in LEVELS] + [(1.0, s) for s in LONGER_S]:
                if half_s > HALF_PULSE_S and not self._may_be_longer(pair, half_s):
                    break
                way, pair = self._homeward(joint, pair), []
                for sign in (way, -way):
                    effort_nm = float(sign * level * self._guard.most_nm[joint])
                    pair.append((yield from self._push(joint, effort_nm, half_s)))
                    if pair[-1].stood_still and self._lively is not None:
                        yield from self._ask_for_life(self._lively)
                there, back = (pulse.reach_rad for pulse in pair)
                clear = np.minimum(np.abs(there), np.abs(back)) >= self._clear_rad
                if np.any(clear & (there * back < 0.0)):
                    break
            self.pulses += pair
        yield from self._test_silence()

    def shown(self) -> Pulsed:
        """Return what the session has shown."""
        ending = (self._guard.complaint or "", self._guard.mend)
        lengths = (self._guard.resolution_rad, self._noticed_rad, self.visible_rad)
        return Pulsed(self.pulses, self.silence, *lengths, *ending, self._model)

    def _push(self, joint: int, effort_nm: float, half_s: float) -> Commands[Pulse]:
        """Command a pulse and the rest after it; return what it has shown."""
        times_s = yield from doublet(self._guard, joint, effort_nm, self._turn_rad, half_s)
        pulse = Pulse(joint, effort_nm, *times_s, self._states(times_s[0] - _BEFORE_S))
        # An arm at rest does not show the steps of its encoders: the first pulse does.
        self._refine(pulse.states.resolution_rad())
        if np.any(np.abs(pulse.reach_rad) >= self.visible_rad):
            self._lively = pulse
        yield from come_to_rest(self._guard, self._obeying(pulse), abs(effort_nm), self._rest_rad)
        return pulse

    def _homeward(self, joint: int, before: Sequence[Pulse]) -> float:
        """Return the sign of the next pair's first pulse: back to where the arm was, once it has got far."""
        away_rad = self._guard.away_rad[joint]
        if not before or abs(away_rad) < TURN_SHARE * self._guard.bounds.range_rad:
            return 1.0
        return float(-np.sign(away_rad * before[-1].reach_rad[joint] * before[-1].effort_nm)) or 1.0

    def _ask_for_life(self, lively: Pulse) -> Commands[None]:
        """Repeat a pulse that has moved something, to tell a joint that cannot move from frozen readings."""
        again = yield from self._push(lively.joint, lively.effort_nm, lively.turn_s - lively.start_s)
        if again.stood_still:
            push = f"{self._guard.joints[lively.joint]} was pushed with {abs(lively.effort_nm):.3g} N·m"
            self._guard.stop_frozen(f"{push}, which moved something before, and nothing now")

    def _may_be_longer(self, pair: Sequence[Pulse], half_s: float) -> bool:
        """Return whether something has moved a little, or by the URDF cannot go too far."""
        goes_rad = expected_reach_rad(pair[0], self._model)
        if goes_rad is not None:
            goes_rad *= (half_s / (pair[0].turn_s - pair[0].start_s)) ** 2
        furthest_rad = FURTHEST_SHARE * self._guard.bounds.range_rad
        seen = any(np.any(np.abs(pulse.reach_rad) >= self._noticed_rad) for pulse in pair)
        return seen or (goes_rad is not None and abs(goes_rad) <= furthest_rad)

    def _refine(self, resolution_rad: FloatArray) -> None:
        """Take in the resolution of the positions; stop if it is too coarse for the range of the pulses."""
        range_rad = self._guard.bounds.range_rad
        coarse_rad = self._guard.resolution_rad = np.maximum(self._guard.resolution_rad, resolution_rad)
        self.visible_rad: FloatArray = np.maximum(VISIBLE_SHARE * range_rad, VISIBLE_STEPS * coarse_rad)
        """How far each joint has to go to be judged by it."""
        # At rest an encoder shows its noise, in motion its steps.
        self._noticed_rad = np.maximum(
            0.25 * VISIBLE_SHARE * range_rad, np.maximum(2.0 * self._noise_rad, 0.9 * coarse_rad)
        )
        clear_rad = np.maximum(CLEAR_SHARE * range_rad, CLEAR_STEPS * coarse_rad)
        self._clear_rad = np.minimum(clear_rad, FURTHEST_SHARE * range_rad)
        self._turn_rad = max(TURN_SHARE * range_rad, float((0.5 * self._clear_rad + coarse_rad).max()))
        self._rest_rad = np.maximum(0.01 * range_rad, VISIBLE_STEPS * coarse_rad)
        j = int(np.argmax(self.visible_rad))
        if self.visible_rad[j] > 0.4 * range_rad:
            self._guard.stop(
                f"the position of {self._guard.joints[j]} comes in steps of {coarse_rad[j]:.3g} rad, too "
                f"coarse for a range of {range_rad:g} rad",
                "are the positions degrees instead of radians? Else more room (--range "
                f"{VISIBLE_STEPS * coarse_rad[j] / 0.4:.2g} or more), or a finer encoder",
            )

    def _obeying(self, pulse: Pulse) -> FloatArray:
        """Return B for the joint that was pushed if it went that way, else nothing."""
        damping = np.zeros_like(self._damping)
        went_rad = pulse.reach_rad[pulse.joint] * np.sign(pulse.effort_nm)
        if went_rad >= self.visible_rad[pulse.joint]:
            damping[pulse.joint] = self._damping[pulse.joint]
        return damping

    def _test_silence(self) -> Commands[None]:
        """Find out what happens without commands, on the joint that best answers its own."""
        shown = self.shown()
        sound = [p for p in self.pulses if not unsound(shown, p.joint, self._guard.joints)]
        if not sound:
            return
        pulse = max(sound, key=lambda pulse: float(abs(pulse.reach_rad[pulse.joint])))
        went_rad = float(np.abs(pulse.reach_rad).max())
        # A doublet with halves of length T goes a T²; a constant effort for a time t goes a t² / 2.
        acceleration = went_rad / (pulse.turn_s - pulse.start_s) ** 2
        would_go_rad = 0.5 * acceleration * (HALF_PULSE_S + SILENCE_S) ** 2
        share = min(0.5, SILENCE_SHARE * self._guard.bounds.range_rad / would_go_rad)
        effort_nm, times_s = abs(pulse.effort_nm) * share, list[float]()
        try:
            yield from fall_silent(self._guard, pulse.joint, effort_nm, times_s)
        finally:  # also where a joint has left its range after that
            if times_s:
                start_s, silent_s, end_s = times_s
                states = self._states(start_s - _BEFORE_S).between(-np.inf, end_s)
                self.silence = Silence(pulse.joint, effort_nm, start_s, silent_s, end_s, states)
        yield from come_to_rest(self._guard, self._obeying(pulse), effort_nm, self._rest_rad)
