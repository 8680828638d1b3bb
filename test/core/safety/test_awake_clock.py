"""Time in which a process stood still does not count as silence of others."""

from __future__ import annotations

import pytest

from tel_ros.core.safety.awake_clock import AwakeClock


def test_it_agrees_with_the_clock_on_the_wall_while_somebody_looks_often() -> None:
    clock = AwakeClock(0.01, 100.0)
    for k in range(1, 501):
        clock.look(100.0 + 0.002 * k)
    assert clock.time_s == pytest.approx(1.0, rel=1e-9)


def test_a_stall_counts_as_one_step_only() -> None:
    clock = AwakeClock(0.01, 5.0)
    assert clock.look(7.0) == 0.01


def test_it_never_runs_backwards() -> None:
    clock = AwakeClock(0.01, 5.0)
    before = clock.look(5.005)
    assert clock.look(4.0) == before
    assert clock.look(4.001) == pytest.approx(before + 0.001)
