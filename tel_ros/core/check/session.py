"""The order of the pulses: from the weakest on, joint by joint, there and back."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from tel_ros.core.check.evidence import Pulse, Pulsed, Silence, StateRecord
from tel_ros.core.check.pulses import SILENCE_S, ComeToRest, Doublet, FallSilent, Program, PulseGuard
from tel_ros.core.types import FloatArray

LEVELS = (1 / 16, 1 / 8, 1 / 4, 1 / 2, 1.0)
"""Shares of the largest effort that are tried, until a joint moves clearly."""
# Shares of the allowed range:
VISIBLE_SHARE = 0.008  # a joint has moved at all
CLEAR_SHARE = 0.04  # it has moved so clearly that no stronger pulse is needed
TURN_SHARE = 0.1  # a pulse turns round early
SILENCE_SHARE = 0.15  # the test of the watchdog may use it if there is none
_BEFORE_S = 0.03

States = Callable[[float], StateRecord]


class PulseSession:
    """Makes the programs and keeps what they show; brakes with B, the damping.

    ``states`` returns what has arrived since a time. It is asked while the arm waits, so it has to be quick.
    """

    def __init__(
        self, guard: PulseGuard, damping_nms_per_rad: FloatArray, resolution_rad: FloatArray, states: States
    ) -> None:
        self._guard, self._damping, self._states = guard, damping_nms_per_rad, states
        self._resolution_rad = np.zeros_like(damping_nms_per_rad)
        self._refine(resolution_rad)
        self.pulses: list[Pulse] = []
        """The strongest pair of pulses of each joint."""
        self.silence: Silence | None = None

    def programs(self) -> Iterator[Program]:
        """Yield one program after the other; each has to be run to its end before the next is asked for."""
        still = np.zeros_like(self._damping)
        yield ComeToRest(self._guard, still, 0.0, self._rest_rad)
        for joint in range(len(self._damping)):
            for level in LEVELS:
                pair: list[Pulse] = []
                for sign in (1.0, -1.0):
                    if self._guard.complaint is not None:
                        return
                    effort_nm = float(sign * level * self._guard.most_nm[joint])
                    doublet = Doublet(self._guard, joint, effort_nm, self._turn_rad)
                    yield doublet
                    if self._guard.complaint is not None:
                        return
                    pair.append(self._pulse(doublet))
                    # An arm at rest does not show the steps of its encoders: the first pulse does.
                    self._refine(pair[-1].states.resolution_rad())
                    yield ComeToRest(self._guard, self._obeying(pair[-1]), abs(effort_nm), self._rest_rad)
                if all(np.any(np.abs(p.displacement_rad()) >= self._clear_rad) for p in pair):
                    break
            self.pulses += pair
        yield from self._test_silence()

    def shown(self, inertia_kgm2: FloatArray | None, friction_nms_per_rad: FloatArray) -> Pulsed:
        """Return what the session has shown, with what the URDF says of the arm (see :class:`Pulsed`)."""
        ending = (self._guard.complaint or "", self._guard.mend)
        of_urdf = (inertia_kgm2, friction_nms_per_rad)
        return Pulsed(self.pulses, self.silence, self.visible_rad, *ending, *of_urdf)

    def _refine(self, resolution_rad: FloatArray) -> None:
        """Take in the resolution of the positions; stop if it is too coarse for the range of the pulses."""
        self._resolution_rad = np.maximum(self._resolution_rad, resolution_rad)
        coarse_rad, range_rad = self._resolution_rad, self._guard.bounds.range_rad
        self.visible_rad: FloatArray = np.maximum(VISIBLE_SHARE * range_rad, 4.0 * coarse_rad)
        """How far each joint has to go to have moved at all."""
        self._clear_rad = np.maximum(CLEAR_SHARE * range_rad, 12.0 * coarse_rad)
        self._turn_rad = max(TURN_SHARE * range_rad, float(self._clear_rad.max()))
        self._rest_rad = np.maximum(0.01 * range_rad, 4.0 * coarse_rad)
        if self._turn_rad > 0.5 * range_rad:
            j = int(np.argmax(coarse_rad))
            self._guard.stop(
                f"the position of {self._guard.joints[j]} comes in steps of {coarse_rad[j]:.3g} rad, too "
                f"coarse for a range of {range_rad:g} rad",
                "are the positions degrees instead of radians? Else more room (--range) or a finer encoder",
            )

    def _obeying(self, pulse: Pulse) -> FloatArray:
        """Return B for the joint that was pushed if it went that way, else nothing."""
        damping = np.zeros_like(self._damping)
        went_rad = pulse.displacement_rad()[pulse.joint] * np.sign(pulse.effort_nm)
        if went_rad >= self.visible_rad[pulse.joint]:
            damping[pulse.joint] = self._damping[pulse.joint]
        return damping

    def _pulse(self, doublet: Doublet) -> Pulse:
        start_s = doublet.start_s - _BEFORE_S
        times_s = (doublet.start_s, doublet.turn_s, doublet.zero_s, doublet.end_s)
        states = self._states(start_s).between(start_s, doublet.end_s)
        return Pulse(doublet.joint, doublet.effort_nm, *times_s, states)

    def _test_silence(self) -> Iterator[Program]:
        """Yield the program that finds out what happens without commands, on the joint that moves most."""
        if self._guard.complaint is not None or not self.pulses:
            return
        pulse = max(self.pulses, key=lambda pulse: float(np.abs(pulse.displacement_rad()).max()))
        went_rad = float(np.abs(pulse.displacement_rad()).max())
        if went_rad < float(self.visible_rad.min()):
            return
        # A doublet with halves of length T goes a T²; a constant effort for a time t goes a t² / 2.
        acceleration = went_rad / (pulse.turn_s - pulse.start_s) ** 2
        would_go_rad = 0.5 * acceleration * (0.05 + SILENCE_S) ** 2
        share = min(0.5, SILENCE_SHARE * self._guard.bounds.range_rad / would_go_rad)
        program = FallSilent(self._guard, pulse.joint, abs(pulse.effort_nm) * share)
        yield program
        if not np.isnan(program.end_s):
            times_s = (program.start_s, program.silent_s, program.end_s)
            states = self._states(program.start_s).between(program.start_s, program.end_s)
            self.silence = Silence(pulse.joint, program.effort_nm, *times_s, states)
        if self._guard.complaint is None:
            yield ComeToRest(self._guard, self._obeying(pulse), program.effort_nm, self._rest_rad)
