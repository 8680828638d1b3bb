"""A planar arm at the terminals of its drives, with the faults that a real one may have. No ROS."""

from __future__ import annotations

import math
import sys
from collections import deque
from dataclasses import dataclass
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "core"))

from two_link import TwoLinkArm  # noqa: E402

FAULTS = (
    "",
    "swapped_commands",
    "swapped_states",
    "flipped_effort",
    "flipped_position",
    "degrees",
    "degrees_velocity",
    "stale_stamps",
    "late_states",
    "command_delay",
    "dead_channel",
    "no_watchdog",
    "no_effort_field",
    "no_watchdog_no_effort_field",
    "effort_in_percent",
    "weak_effort",
    "limited_effort",
    "frozen",
    "frozen_elbow",
    "frozen_position",
    "frozen_velocity",
    "no_velocity_frozen",
    "zero_velocity",
)
DELAY_S = 0.020
LATE_S = 0.040
WATCHDOG_S = 0.02
LIMIT_NM = 20.0
LIMITED_NM = 1.0
ENCODER_RAD = 2.0 * math.pi / 2**16


@dataclass(frozen=True)
class Reading:
    """What the driver says of one period."""

    position: list[float]
    velocity: list[float]
    effort: list[float]
    stamp_s: float


class FaultyArm:
    """Two links, encoders of 16 bits, a watchdog, and one fault.

    Args:
        fault: one of :data:`FAULTS`; empty: none.
        period_s: control period.
        posture_rad: at the start.
        watchdog_s: after how long without a command the effort goes to zero.
        from_s: when readings freeze, of the faults that do so.
        encoder_rad: step in which positions are read.
    """

    def __init__(
        self,
        fault: str = "",
        period_s: float = 0.002,
        posture_rad: tuple[float, float] = (0.2, 0.5),
        watchdog_s: float = WATCHDOG_S,
        from_s: float = 0.0,
        encoder_rad: float = ENCODER_RAD,
    ) -> None:
        assert fault in FAULTS, fault
        self.from_s, self._encoder_rad, self._frozen = from_s, encoder_rad, (np.zeros(2), np.zeros(2))
        self._watchdog_s = watchdog_s
        self.fault, self.period_s = fault, period_s
        self.arm = TwoLinkArm(q=posture_rad)
        self.time_s = 0.0
        self.peak_nm = np.zeros(2)
        """The largest effort that has acted on each motor."""
        self._command, self._commanded_s = np.zeros(2), -math.inf
        self._on_the_way: deque[tuple[float, np.ndarray]] = deque()
        self._effort = np.zeros(2)
        self._past: deque[Reading] = deque(maxlen=1 + round(LATE_S / period_s))
        while fault == "late_states" and len(self._past) < LATE_S / period_s:
            self.step()

    def command(self, effort_nm: list[float]) -> None:
        """Take a command."""
        late_s = DELAY_S if self.fault == "command_delay" else 0.0
        self._on_the_way.append((self.time_s + late_s, np.array(effort_nm, dtype=float)))

    def step(self) -> Reading:
        """Let one period pass and return what the driver says of it."""
        while self._on_the_way and self._on_the_way[0][0] <= self.time_s + 1e-9:
            self._commanded_s, self._command = self.time_s, self._on_the_way.popleft()[1]
        if not self.fault.startswith("no_watchdog") and self.time_s - self._commanded_s > self._watchdog_s:
            self._command = np.zeros(2)
        effort = np.clip(self._command, -LIMIT_NM, LIMIT_NM)
        motor = effort.copy()
        if self.fault == "swapped_commands":
            motor = motor[::-1]
        if self.fault == "flipped_effort":
            motor = motor * [1.0, -1.0]
        if self.fault == "dead_channel":
            effort, motor = effort * [0.0, 1.0], motor * [0.0, 1.0]
        if self.fault == "limited_effort":
            effort = motor = np.clip(motor, -LIMITED_NM, LIMITED_NM)
        if self.fault == "effort_in_percent":
            motor = motor * LIMIT_NM
        if self.fault == "weak_effort":
            motor = motor / 10.0
        self.peak_nm = np.maximum(self.peak_nm, np.abs(motor))
        self.arm.step(motor, self.period_s)
        self.time_s += self.period_s
        self._past.append(self._reading(effort))
        if self.fault == "late_states":
            return self._past[0]
        return self._past[-1]

    def _reading(self, effort: np.ndarray) -> Reading:
        position = np.round(np.array(self.arm.q) / self._encoder_rad) * self._encoder_rad
        velocity = np.array(self.arm.v)
        if self.time_s < self.from_s:
            self._frozen = position, velocity
        elif "frozen" in self.fault:
            which = [False, True] if self.fault == "frozen_elbow" else [True, True]
            if self.fault != "frozen_velocity":
                position = np.where(which, self._frozen[0], position)
            if self.fault != "frozen_position":
                velocity = np.where(which, self._frozen[1], velocity)
        if self.fault == "zero_velocity":
            velocity = np.zeros(2)
        if self.fault.startswith("no_velocity"):
            velocity = np.full(2, np.nan)
        stamp_s = 0.0 if self.fault == "stale_stamps" else self.time_s
        if self.fault == "swapped_states":
            position, velocity = position[::-1], velocity[::-1]
        if self.fault == "flipped_position":
            position, velocity = position * [-1.0, 1.0], velocity * [-1.0, 1.0]
        if self.fault == "degrees":
            position = np.degrees(position)
        if self.fault in ("degrees", "degrees_velocity"):
            velocity = np.degrees(velocity)
        told = [] if self.fault.endswith("no_effort_field") else effort.tolist()
        return Reading(position.tolist(), velocity.tolist(), told, stamp_s)
