"""Efforts that act for longer than they were meant to, and states that were long on their way."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from two_link import Bench, TwoLinkArm, arm_config, loops, make_bench

from tel_ros.core.arm_state import ArmState
from tel_ros.core.config import SafetyConfig
from tel_ros.core.safety.layer import SafetyLayer
from tel_ros.core.safety.rules import LateStates
from tel_ros.core.trial import Outcome, Phase, Tick
from tel_ros.core.types import NS_PER_S

MS = 1_000_000


def test_punctual_states_leave_efforts_alone_and_late_ones_reduce_them_in_proportion() -> None:
    assert LateStates(0.002).share(0.002, 0.0) == LateStates(0.002).share(0.010, 0.0) == 1.0
    assert LateStates(0.002).share(0.040, 0.0) == pytest.approx(0.25)
    # A slow loop has its own idea of what is late.
    assert LateStates(0.010).share(0.020, 0.0) == 1.0
    assert LateStates(0.010).share(0.040, 0.0) == pytest.approx(0.5)


def test_the_layer_reduces_the_effort_of_a_late_state_and_gives_all_of_it_to_the_next_one() -> None:
    layer = SafetyLayer(arm_config(), SafetyConfig(effort_rate_nm_per_s=(1e9, 1e9)), 500.0)

    def permitted(time_ms: int) -> tuple[list[float], list[bool]]:
        state = ArmState(time_ms * MS, np.zeros(2), np.zeros(2))
        effort, changed = layer.permit(state, np.array([10.0, -4.0]))
        return effort.tolist(), changed.tolist()

    assert permitted(100) == ([10.0, -4.0], [False, False])
    assert permitted(102) == ([10.0, -4.0], [False, False])
    assert permitted(122) == ([5.0, -2.0], [True, True])
    assert permitted(124) == ([10.0, -4.0], [False, False])


@pytest.mark.parametrize("gap_ms", [20, 60, 80, 96])
def test_states_that_come_one_at_a_time_do_not_drive_the_arm_wild(gap_ms: int) -> None:
    """Without the rule the same arm reaches tens of rad/s from 60 ms on, with every time-out kept."""
    bench = make_bench()
    bench.controller.start(loops(4.5))
    bench.until_phase(Phase.RUN)
    bench.steps(0.2)
    bench.period_ns = gap_ms * MS
    start = len(bench.states)
    for _ in range(round(4000 / gap_ms)):
        bench.step()
    assert np.abs(bench.velocity_rad_s[start:]).max() < 6.0


def test_the_layer_counts_age_and_gap_together() -> None:
    layer = SafetyLayer(arm_config(), SafetyConfig(effort_rate_nm_per_s=(1e9, 1e9)), 500.0)

    def permitted(time_ms: int, age_ms: float) -> list[float]:
        state = ArmState(time_ms * MS, np.zeros(2), np.zeros(2), age_s=age_ms / 1e3)
        return layer.permit(state, np.array([10.0, -4.0])).effort_nm.tolist()

    assert permitted(100, 0.0) == [10.0, -4.0]
    assert permitted(102, 3.9) == [10.0, -4.0]
    assert permitted(104, 9.0) == pytest.approx([5.0, -2.0])
    assert permitted(124, 10.0) == pytest.approx([2.5, -1.0])


@dataclass
class LateBench(Bench):
    """A bench on which states come some periods late.

    Args:
        late_periods: how many.
        knows: whether the controller is told how old they are.
    """

    late_periods: int = 0
    knows: bool = True

    def __post_init__(self) -> None:
        self._measured: list[ArmState] = []
        self._answer: Tick | None = None

    def step(self) -> Tick | None:
        """Measure the present state, show one from before, and let the answer act for a period."""
        self._measured.append(ArmState(self.time_ns, np.array(self.arm.q), np.array(self.arm.v)))
        seen = self._measured[max(0, len(self._measured) - 1 - self.late_periods)]
        if not self.states or seen.time_ns > self.states[-1].time_ns:
            age_s = (self.time_ns - seen.time_ns) / NS_PER_S if self.knows else 0.0
            state = ArmState(seen.time_ns, seen.position_rad, seen.velocity_rad_s, age_s)
            self._answer = self.controller.tick(state)
            self.states.append(state)
            self.ticks.append(self._answer)
        effort_nm = np.zeros(2) if self._answer is None else self._answer.effort_nm
        self.arm.step(effort_nm, self.period_ns / NS_PER_S)
        self.time_ns += self.period_ns
        return self._answer


def fastest_rad_s(late_ms: int, knows: bool) -> float:
    """Return the largest speed of a light arm during a trial whose states are late from somewhere on."""
    light = TwoLinkArm(inertia_scale=0.2)
    bench = LateBench(make_bench().controller, light, knows=knows)
    bench.controller.start(loops(4.5))
    bench.until_phase(Phase.RUN)
    bench.steps(0.2)
    bench.late_periods = late_ms // 2
    fastest = 0.0
    for _ in range(1000):
        bench.step()
        fastest = max(fastest, *map(abs, light.v))
    return fastest


@pytest.mark.parametrize("late_ms", [22, 40, 60, 90])
def test_states_that_are_late_do_not_make_light_joints_swing_up(late_ms: int) -> None:
    assert fastest_rad_s(late_ms, knows=True) < 6.0


def test_without_knowing_that_they_are_late_they_would() -> None:
    assert fastest_rad_s(40, knows=False) > 15.0


def test_states_that_are_older_than_the_time_out_end_the_trial() -> None:
    bench = LateBench(make_bench().controller)
    bench.controller.start(loops(4.5))
    bench.until_phase(Phase.RUN)
    bench.late_periods = 51
    report = bench.finish()
    assert report.outcome == Outcome.ABORTED
    assert report.message == "the joint states come 0.102 s late (time-out 0.1 s)"
