"""Efforts that act for longer than they were meant to."""

from __future__ import annotations

import numpy as np
import pytest
from two_link import arm_config, loops, make_bench

from tel_ros.core.arm_state import ArmState
from tel_ros.core.config import SafetyConfig
from tel_ros.core.safety.late_states import share_of_effort
from tel_ros.core.safety.layer import SafetyLayer
from tel_ros.core.trial import Phase

MS = 1_000_000


def test_punctual_states_leave_efforts_alone_and_late_ones_reduce_them_in_proportion() -> None:
    assert share_of_effort(0.002, 0.002) == share_of_effort(0.010, 0.002) == 1.0
    assert share_of_effort(0.040, 0.002) == pytest.approx(0.25)
    # A slow loop has its own idea of what is late.
    assert share_of_effort(0.020, 0.010) == 1.0
    assert share_of_effort(0.040, 0.010) == pytest.approx(0.5)


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
