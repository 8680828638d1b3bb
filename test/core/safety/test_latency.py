"""States that were long on their way: how late they are, and that they do not drive an arm wild."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from two_link import Bench, TwoLinkArm, arm_config, loops, make_bench

from tel_ros.core.arm_state import ArmState
from tel_ros.core.config import SafetyConfig
from tel_ros.core.safety.latency import Latency
from tel_ros.core.safety.layer import SafetyLayer
from tel_ros.core.trial import Outcome, Phase, Tick
from tel_ros.core.types import NS_PER_S

MS = 1_000_000
EPOCH_NS = 1_790_000_000 * NS_PER_S
"""An arm stamps with the time of day, this machine counts from when it was switched on."""


def heard(latency: Latency, on_the_way_ms: list[float], first_ms: float = 0.0) -> np.ndarray:
    """Return how late states are, in ms, that are measured every 2 ms and are on their way for so long."""
    stamps_ms = first_ms + 2.0 * np.arange(len(on_the_way_ms))
    arrivals_ms = stamps_ms + np.array(on_the_way_ms)
    return np.array(
        [
            1e3 * latency.of(EPOCH_NS + round(s * MS), 5 * NS_PER_S + round(a * MS))
            for s, a in zip(stamps_ms, arrivals_ms, strict=True)
        ]
    )


def test_a_state_is_late_by_what_it_took_longer_than_the_fastest_one_so_far() -> None:
    late_ms = heard(Latency(0.0), [1.0, 1.5, 0.5, 20.5, 0.7])
    np.testing.assert_allclose(late_ms, [0.0, 0.5, 0.0, 20.0, 0.2], atol=1e-3)


def test_after_stamps_that_go_back_lateness_counts_anew() -> None:
    latency = Latency(0.0)
    heard(latency, [1.0, 1.0])
    set_back = heard(latency, [31.0, 31.0, 41.0], first_ms=-500.0)
    np.testing.assert_allclose(set_back, [0.0, 0.0, 10.0], atol=1e-3)


def test_stamps_that_jump_forward_make_nothing_late() -> None:
    latency = Latency(0.0)
    heard(latency, [1.0, 1.0])
    np.testing.assert_allclose(heard(latency, [1.0, 1.0], first_ms=3.6e6), 0.0, atol=1e-3)


@pytest.mark.parametrize("drift", [-0.0005, 0.0005])
def test_a_clock_that_drifts_by_less_than_is_allowed_never_makes_states_late(drift: float) -> None:
    latency = Latency(0.001)
    late_s = [latency.of(EPOCH_NS + round((1.0 - drift) * k * 2 * MS), k * 2 * MS) for k in range(30_000)]
    assert max(late_s) < 1e-5


def test_states_that_stay_late_are_taken_for_punctual_as_slowly_as_a_clock_may_drift() -> None:
    latency = Latency(0.001)
    late_ms = heard(latency, [1.0, *([41.0] * 5000)])
    assert late_ms[1] == pytest.approx(40.0, abs=0.1)
    assert late_ms[-1] == pytest.approx(30.0, abs=0.1)


def test_with_a_simulator_that_is_slower_than_real_time_nothing_is_late_if_that_is_configured() -> None:
    half_speed = Latency(1.0)
    assert max(half_speed.of(k * MS, EPOCH_NS + k * 2 * MS) for k in range(1000)) == 0.0


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
