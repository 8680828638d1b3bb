"""A whole check of a faulty arm in virtual time, without ROS."""

from __future__ import annotations

import sys
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2] / "contract"))

from faulty_arm import FaultyArm, Reading  # noqa: E402
from two_link import arm_config  # noqa: E402

from tel_ros.core.check.evidence import StateRecord  # noqa: E402
from tel_ros.core.check.pulses import Program, PulseBounds, PulseGuard  # noqa: E402
from tel_ros.core.check.session import PulseSession  # noqa: E402

JOINTS = ("shoulder", "elbow")
START_S = 100.0
TRAVEL_S = 0.0003


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
    _rows: list[tuple[float, Reading]] = field(default_factory=list)
    session: PulseSession | None = None
    guard: PulseGuard | None = None

    def listen(self, duration_s: float = 1.0) -> StateRecord:
        for _ in range(round(duration_s / self.arm.period_s)):
            self._next()
        return self.states()

    def pulse(self, lost_after_s: float | None = None) -> PulseSession:
        """Run all programs; states may be lost some time after the beginning."""
        states = self.states()
        now_s = self._rows[-1][0]
        damping = np.array(arm_config().damping_nms_per_rad)
        self.guard = PulseGuard(arm_config(), self.bounds, states.position_rad[-1], now_s)
        self.session = PulseSession(self.guard, damping, states.resolution_rad(), self.states)
        end_s = np.inf if lost_after_s is None else now_s + lost_after_s
        for program in self.session.programs():
            self._run(program, end_s)
        return self.session

    def states(self, since_s: float = 0.0) -> StateRecord:
        rows = [row for row in self._rows if row[0] >= since_s]
        n = len(rows)
        effort = [r.effort or [np.nan, np.nan] for _, r in rows]
        received = np.array([t for t, _ in rows])
        stamps = np.array([START_S + r.stamp_s for _, r in rows])
        return StateRecord(
            JOINTS,
            received,
            np.round(stamps * 1e9).astype(np.int64),
            received - stamps,
            np.array([r.position for _, r in rows]).reshape(n, 2),
            np.array([r.velocity for _, r in rows]).reshape(n, 2),
            np.array(effort).reshape(n, 2),
        )

    def _next(self) -> tuple[float, np.ndarray]:
        reading = self.arm.step()
        self._rows.append((START_S + self.arm.time_s + TRAVEL_S, reading))
        return self._rows[-1][0], np.array(reading.position)

    def _run(self, program: Program, lost_s: float) -> None:
        while not program.done:
            now_s = START_S + self.arm.time_s + TRAVEL_S
            if now_s >= lost_s:
                self.arm.step()
                self._send(program.watch(now_s))
                continue
            self._send(program.step(*self._next()))

    def _send(self, effort: np.ndarray | None) -> None:
        if effort is not None:
            self.sent_nm.append(effort)
            self.arm.command(effort.tolist())
