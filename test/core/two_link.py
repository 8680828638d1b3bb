"""A planar two-link arm in formulas, and a bench on which the controller drives it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from math import cos, sin

import numpy as np

from tel_ros.core.arm_state import ArmState
from tel_ros.core.config import ArmConfig, ControlConfig, SafetyConfig
from tel_ros.core.control.controller import EpController
from tel_ros.core.trajectories.paths import NAMED_PATHS, Path, waypoint_path
from tel_ros.core.trajectories.trajectory import sample
from tel_ros.core.trial import Phase, Tick, TrialGoal, TrialReport
from tel_ros.core.types import NS_PER_S, FloatArray, IntArray

RATE_HZ = 500.0

ARM = {
    "name": "two_link",
    "urdf": "two_link.urdf",
    "joints": ("shoulder", "elbow"),
    "hand_link": "hand",
    "stiffness_nm_per_rad": (15.0, 15.0),
    "damping_nms_per_rad": (1.5, 1.5),
    "effort_limit_nm": (20.0, 20.0),
    "position_min_rad": (-2.9, -2.9),
    "position_max_rad": (2.9, 2.9),
    "velocity_limit_rad_s": (15.0, 15.0),
}


def no_torque(time_s: float) -> tuple[float, float]:
    """Nobody touches the arm."""
    return 0.0, 0.0


class TwoLinkArm:
    """Uniform masses m and inertias I at the middle of links of equal length, viscous friction, no gravity.

    Args:
        q: joint positions in rad.
        v: joint velocities in rad/s.
        friction_nms_per_rad: of both joints.
        inertia_scale: factor on all masses and inertias.
        push: from the time in s to the torque in N·m with which somebody pushes each joint.
    """

    LENGTH, CENTRE = 0.33, 0.165
    MASS, INERTIA = (2.0, 1.2), (0.05, 0.02)

    def __init__(
        self,
        q: tuple[float, float] = (0.6, 1.3),
        v: tuple[float, float] = (0.0, 0.0),
        friction_nms_per_rad: float = 0.05,
        inertia_scale: float = 1.0,
        push: Callable[[float], tuple[float, float]] = no_torque,
    ) -> None:
        self.q, self.v, self.time_s, self.push = tuple(q), tuple(v), 0.0, push
        self.friction = friction_nms_per_rad
        (m1, m2), (i1, i2) = self.MASS, self.INERTIA
        self._elbow = inertia_scale * (i2 + m2 * self.CENTRE**2)
        self._carried = inertia_scale * (i1 + m1 * self.CENTRE**2 + m2 * self.LENGTH**2)
        self._coupling = inertia_scale * m2 * self.LENGTH * self.CENTRE

    def inverse_dynamics(self, q: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
        """Return the torque in N·m for rows of q, q̇, q̈, friction included. Shapes (n, 2)."""
        c, s = self._coupling * np.cos(q[:, 1]), self._coupling * np.sin(q[:, 1])
        (v1, v2), (a1, a2) = v.T, a.T
        shoulder = (self._carried + self._elbow + 2 * c) * a1 + (self._elbow + c) * a2
        shoulder += -s * (2 * v1 * v2 + v2**2)
        elbow = (self._elbow + c) * a1 + self._elbow * a2 + s * v1**2
        return np.column_stack([shoulder, elbow]) + self.friction * v

    def kinetic_energy(self) -> float:
        """Return the energy in J."""
        c = self._coupling * cos(self.q[1])
        v1, v2 = self.v
        inertia = self._carried + self._elbow + 2 * c
        return 0.5 * inertia * v1**2 + (self._elbow + c) * v1 * v2 + 0.5 * self._elbow * v2**2

    def step(self, effort_nm: FloatArray, dt_s: float) -> None:
        """Hold the torques for a while: one Runge-Kutta step of order 4, error below 1e-9 rad at 500 Hz."""
        push, h = self.push(self.time_s), 0.5 * dt_s
        nm = float(effort_nm[0]) + push[0], float(effort_nm[1]) + push[1]
        (q1, q2), (v1, v2) = self.q, self.v
        a1, a2 = self._acceleration(q2, v1, v2, *nm)
        w1, w2 = v1 + h * a1, v2 + h * a2
        b1, b2 = self._acceleration(q2 + h * v2, w1, w2, *nm)
        x1, x2 = v1 + h * b1, v2 + h * b2
        c1, c2 = self._acceleration(q2 + h * w2, x1, x2, *nm)
        y1, y2 = v1 + dt_s * c1, v2 + dt_s * c2
        d1, d2 = self._acceleration(q2 + dt_s * x2, y1, y2, *nm)
        sixth = dt_s / 6.0
        self.q = q1 + sixth * (v1 + 2 * w1 + 2 * x1 + y1), q2 + sixth * (v2 + 2 * w2 + 2 * x2 + y2)
        self.v = v1 + sixth * (a1 + 2 * b1 + 2 * c1 + d1), v2 + sixth * (a2 + 2 * b2 + 2 * c2 + d2)
        self.time_s += dt_s

    def _acceleration(self, q2: float, v1: float, v2: float, t1: float, t2: float) -> tuple[float, float]:
        c, s = self._coupling * cos(q2), self._coupling * sin(q2)
        r1 = t1 - self.friction * v1 + s * (2 * v1 * v2 + v2 * v2)
        r2 = t2 - self.friction * v2 - s * v1 * v1
        m11, m12, m22 = self._carried + self._elbow + 2 * c, self._elbow + c, self._elbow
        det = m11 * m22 - m12 * m12
        return (m22 * r1 - m12 * r2) / det, (m11 * r2 - m12 * r1) / det


@dataclass
class Bench:
    """An arm, its controller and all that was said between them.

    Args:
        controller: of the arm.
        arm: the plant.
        time_ns: stamp of the next state.
        period_ns: from one state to the next.
        encoder_rad: step in which positions are read; 0 reads them exactly.
    """

    controller: EpController
    arm: TwoLinkArm = field(default_factory=TwoLinkArm)
    time_ns: int = NS_PER_S
    period_ns: int = round(NS_PER_S / RATE_HZ)
    encoder_rad: float = 0.0
    states: list[ArmState] = field(default_factory=list)
    ticks: list[Tick] = field(default_factory=list)

    def step(self) -> Tick | None:
        """Show the controller the present state and let its answer act for one period."""
        q, v = np.array(self.arm.q), np.array(self.arm.v)
        if self.encoder_rad:
            q = np.round(q / self.encoder_rad) * self.encoder_rad
        state = ArmState(self.time_ns, q, v)
        tick = self.controller.tick(state)
        if tick is not None:
            self.states.append(state)
            self.ticks.append(tick)
        self.arm.step(np.zeros(2) if tick is None else tick.effort_nm, self.period_ns / NS_PER_S)
        self.time_ns += self.period_ns
        return tick

    def steps(self, duration_s: float) -> None:
        """Go on for a while."""
        for _ in range(round(duration_s * NS_PER_S / self.period_ns)):
            self.step()

    def until(self, condition: Callable[[Bench], bool], limit_s: float = 30.0) -> None:
        """Go on until something is so; fail if it does not come to that."""
        end_ns = self.time_ns + round(limit_s * NS_PER_S)
        while not condition(self):
            assert self.time_ns < end_ns, f"still {self.controller.phase.name} after {limit_s} s"
            self.step()

    def until_phase(self, phase: Phase, limit_s: float = 30.0) -> None:
        """Go on until the controller is in a phase."""
        self.until(lambda bench: bench.controller.phase == phase, limit_s)

    def run(self, goal: TrialGoal) -> TrialReport:
        """Run a whole trial."""
        self.controller.start(goal)
        return self.finish()

    def finish(self) -> TrialReport:
        """Go on to the end of the trial that is under way."""
        self.until(lambda bench: not bench.controller.active)
        assert self.controller.report is not None
        return self.controller.report

    def phases(self, start: int = 0) -> list[Phase]:
        """Return the phases of the ticks from some number on, each once for as long as it lasted."""
        phases = [tick.phase for tick in self.ticks[start:]]
        return [phase for k, phase in enumerate(phases) if k == 0 or phases[k - 1] != phase]

    def rows(self, *phases: Phase) -> IntArray:
        """Return the numbers of the ticks in some phases."""
        return np.flatnonzero([tick.phase in phases for tick in self.ticks])

    def column(self, name: str) -> FloatArray:
        """Return one field of all ticks. Shape (n, 2)."""
        return np.array([getattr(tick, name) for tick in self.ticks])

    @property
    def position_rad(self) -> FloatArray:
        """Positions as the controller saw them. Shape (n, 2)."""
        return np.array([state.position_rad for state in self.states])

    @property
    def velocity_rad_s(self) -> FloatArray:
        """Velocities as the controller saw them. Shape (n, 2)."""
        return np.array([state.velocity_rad_s for state in self.states])

    @property
    def stamps_ns(self) -> IntArray:
        """Stamps of the states that were answered. Shape (n,)."""
        return np.array([state.time_ns for state in self.states], dtype=np.int64)


def arm_config(**values: object) -> ArmConfig:
    """Return the description of the arm, with some values replaced."""
    return ArmConfig(**(ARM | values))


def make_bench(
    arm: TwoLinkArm | None = None,
    *,
    description: dict[str, object] | None = None,
    control: dict[str, object] | None = None,
    safety: dict[str, object] | None = None,
    **values: object,
) -> Bench:
    """Return a controller with its arm on the bench, with some values of their configurations replaced."""
    controller = EpController(
        arm_config(**(description or {})), ControlConfig(**(control or {})), SafetyConfig(**(safety or {}))
    )
    return Bench(controller, arm or TwoLinkArm(), **values)


def reach(
    start: tuple[float, float] = (0.6, 1.3),
    end: tuple[float, float] = (0.9, 1.0),
    duration_s: float = 1.0,
    *,
    index: int = 1,
    rate_hz: float = RATE_HZ,
) -> TrialGoal:
    """Return a straight movement from rest to rest."""
    return goal_on(waypoint_path("reach", np.array([start, end])), duration_s, index=index, rate_hz=rate_hz)


def loops(duration_s: float) -> TrialGoal:
    """Return the figure that comes with the project."""
    return goal_on(NAMED_PATHS["planar_loops"], duration_s)


def goal_on(path: Path, duration_s: float, *, index: int = 1, rate_hz: float = RATE_HZ) -> TrialGoal:
    """Return a movement along a path whose command leads it by 50 ms: half of what the dampers hold back."""
    desired = sample(path, duration_s, rate_hz)
    command = desired.position_rad + 0.05 * desired.velocity_rad_s
    return TrialGoal(index=index, alpha=1.0, desired=desired, equilibrium_rad=command)


def in_run(time_s: float, **configuration: dict[str, object]) -> Bench:
    """Return a bench at some time after the beginning of RUN."""
    bench = make_bench(**configuration)
    bench.controller.start(reach())
    bench.until(lambda b: b.controller.time_from_start_s >= time_s)
    return bench


def stopped() -> Bench:
    """Return a bench whose arm is held after a cancellation."""
    bench = in_run(0.5)
    bench.controller.cancel()
    bench.finish()
    return bench
