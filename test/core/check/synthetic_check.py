"""A whole check of a faulty arm in virtual time, without ROS."""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2] / "contract"))

from faulty_arm import FaultyArm, Reading  # noqa: E402
from two_link import TwoLinkArm, arm_config  # noqa: E402

from tel_ros.core.check.evidence import Heard, StateRecord, UrdfModel  # noqa: E402
from tel_ros.core.check.pulses import PulseBounds, PulseGuard  # noqa: E402
from tel_ros.core.check.session import PulseSession  # noqa: E402

JOINTS = ("shoulder", "elbow")
START_S = 100.0
TRAVEL_S = 0.0003
_PIECES = 5


class RoughLinks(TwoLinkArm):
    """Links with dry friction and cogging.

    Args:
        q: joint positions in rad.
        coulomb_nm: dry friction of both joints.
        cogging_nm: torque that draws each joint to the nearest of ``n_cogs`` positions of rest.
        n_cogs: of a turn.
    """

    def __init__(
        self, q: tuple[float, float], coulomb_nm: float, cogging_nm: float, n_cogs: int = 40
    ) -> None:
        super().__init__(q=q)
        self._coulomb_nm, self._cogging_nm, self._n_cogs = coulomb_nm, cogging_nm, n_cogs

    def step(self, effort_nm: np.ndarray, dt_s: float) -> None:
        """Pass a while in pieces, because dry friction is stiff."""
        for _ in range(_PIECES):
            acting_nm = [
                effort
                - self._coulomb_nm * math.tanh(v / 0.003)
                - self._cogging_nm * math.sin(self._n_cogs * q)
                for effort, q, v in zip(effort_nm, self.q, self.v, strict=True)
            ]
            super().step(acting_nm, dt_s / _PIECES)


class RoughArm(FaultyArm):
    """An arm with one fault, and with what is no fault.

    Args:
        fault: as of :class:`FaultyArm`.
        differences: velocities are differences of positions.
        noise_rad: of the positions, standard deviation.
        coulomb_nm: see :class:`RoughLinks`.
        cogging_nm: see :class:`RoughLinks`.
        seed: of the noise.
        more: for :class:`FaultyArm`.
    """

    def __init__(
        self,
        fault: str = "",
        *,
        differences: bool = False,
        noise_rad: float = 0.0,
        coulomb_nm: float = 0.0,
        cogging_nm: float = 0.0,
        seed: int = 0,
        **more: object,
    ) -> None:
        self._differences, self._noise_rad = differences, noise_rad
        self._random = np.random.default_rng(seed)
        self._before: np.ndarray | None = None
        super().__init__(fault, **more)
        if coulomb_nm or cogging_nm:
            self.arm = RoughLinks(self.arm.q, coulomb_nm, cogging_nm)

    def _reading(self, effort: np.ndarray) -> Reading:
        true_rad = self.arm.q
        self.arm.q = tuple(np.array(true_rad) + self._noise_rad * self._random.normal(size=2))
        reading = super()._reading(effort)
        self.arm.q = true_rad
        if self._differences:
            position = np.array(reading.position)
            moved = position - (position if self._before is None else self._before)
            self._before = position
            reading = replace(reading, velocity=(moved / self.period_s).tolist())
        return reading


@dataclass
class SyntheticCheck:
    """Listens to an arm, and pulses it.

    Args:
        arm: its drives.
        bounds: what is allowed.
    """

    arm: FaultyArm
    bounds: PulseBounds = field(default_factory=PulseBounds)
    sent_nm: list[np.ndarray] = field(default_factory=list)
    _rows: list[Heard] = field(default_factory=list)
    session: PulseSession | None = None
    guard: PulseGuard | None = None
    model: UrdfModel = UrdfModel(None, np.zeros(2), "nobody has looked")
    breaks: str = ""
    """What goes wrong from ``breaks_at_s`` on: "silent", "repeats" (old states) or "frozen" (new stamps)."""
    breaks_at_s: float = math.inf
    sent_at_s: list[float] = field(default_factory=list)

    def listen(self, duration_s: float = 1.0) -> StateRecord:
        for _ in range(round(duration_s / self.arm.period_s)):
            self._next()
        return self.states()

    def pulse(self) -> PulseSession:
        """Run all programs."""
        states = self.states()
        damping = np.array(arm_config().damping_nms_per_rad)
        self.guard = PulseGuard(arm_config(), self.bounds, self._rows[-1], quiet_s=states.longest_still_s)
        self.session = PulseSession(self.guard, damping, states.resolution_rad(), self.states, self.model)
        course = self.session.course()
        while not course.done:
            heard = self._next()
            if heard is not None:
                self._send(course.step(heard))
            self._send(course.watch(START_S + self.arm.time_s + TRAVEL_S))
        return self.session

    def states(self, since_s: float = 0.0) -> StateRecord:
        return StateRecord.of(JOINTS, [row for row in self._rows if row.received_s >= since_s])

    def _next(self) -> Heard | None:
        reading = self.arm.step()
        now_s = START_S + self.arm.time_s + TRAVEL_S
        stamp_s = START_S + reading.stamp_s
        values = (reading.position, reading.velocity, reading.effort or [math.nan, math.nan])
        heard = Heard(now_s, round(stamp_s * 1e9), now_s - stamp_s, *map(np.array, values))
        if self.arm.time_s > self.breaks_at_s:
            if self.breaks == "silent":
                return None
            last = self._rows[-1]
            kept = last[1:] if self.breaks == "repeats" else (heard.stamp_ns, heard.age_s, *last[3:])
            heard = Heard(now_s, *kept)
        self._rows.append(heard)
        return heard

    def _send(self, effort: np.ndarray | None) -> None:
        if effort is not None:
            self.sent_nm.append(effort)
            self.sent_at_s.append(self.arm.time_s)
            self.arm.command(effort.tolist())
