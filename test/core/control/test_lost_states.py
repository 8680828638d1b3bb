"""An arm whose states stop, are late or return: without effort, then braked from where it is."""

from __future__ import annotations

import numpy as np
import pytest
from two_link import in_run, make_bench, reach, stopped

from tel_ros.core.arm_state import ArmState
from tel_ros.core.errors import TrajectoryError
from tel_ros.core.trial import Outcome, Phase
from tel_ros.core.types import NS_PER_S

LOST = "no joint state for 0.1 s"


def test_losing_the_states_ends_the_trial_at_once() -> None:
    bench = in_run(0.5)
    bench.controller.lose_states(LOST)
    report = bench.controller.report
    assert (report.outcome, report.message) == (Outcome.ABORTED, LOST)
    assert report.end_ns == bench.stamps_ns[-1]
    assert report.ticks == len(bench.ticks)
    assert not bench.controller.active


def test_losing_states_before_the_first_trial_changes_nothing() -> None:
    bench = make_bench()
    bench.controller.lose_states(LOST)
    assert bench.controller.report is None
    assert bench.step() is None


def test_when_states_return_the_arm_is_braked_from_where_it_is_by_then() -> None:
    bench = in_run(0.5)
    bench.controller.lose_states(LOST)
    bench.arm.q, bench.arm.v = (0.2, 0.9), (1.0, -1.0)
    bench.time_ns += 3 * NS_PER_S
    n = len(bench.ticks)
    bench.steps(3.0)
    np.testing.assert_array_equal(bench.ticks[n].equilibrium_rad, (0.2, 0.9))
    assert bench.phases(n) == [Phase.STOP]
    # Once at rest the springs stay latched, and may push back what little still moves.
    assert np.all((bench.column("effort_nm") * bench.velocity_rad_s)[n:] <= 1e-5)
    assert bench.arm.kinetic_energy() < 1e-4


@pytest.mark.parametrize(("late_ms", "is_held"), [(2, True), (40, True), (60, False)])
def test_the_brake_forgets_the_load_only_when_states_are_late_for_long(late_ms: int, is_held: bool) -> None:
    """The arm is not simulated: whatever is commanded, it rests 0.1 rad below its equilibrium point."""
    controller = make_bench().controller
    below = np.array([0.5, 1.3])
    now_ms = 0

    def answer(age_s: float = 0.0) -> np.ndarray:
        nonlocal now_ms
        now_ms += 2
        tick = controller.tick(ArmState(now_ms * 1_000_000, below + 1e-9 * now_ms, np.zeros(2), age_s))
        assert tick is not None
        return tick.effort_nm

    controller.start(reach())
    while controller.phase != Phase.RUN:
        answer()
    controller.cancel()
    held_nm = answer()
    assert held_nm[0] > 1.3  # 1.5 N·m, smoothed over a while
    for _ in range(late_ms // 2):
        assert 0.0 <= answer(age_s=0.04)[0] < 0.2 * held_nm[0]
    for _ in range(20):
        effort_nm = answer()
    assert effort_nm[0] == pytest.approx(held_nm[0] if is_held else 0.0, abs=0.01)


def test_after_lost_states_the_next_trial_starts_from_rest_and_is_refused_before() -> None:
    bench = in_run(0.5)
    bench.controller.lose_states(LOST)
    with pytest.raises(TrajectoryError, match=r"still being braked; a trial starts from rest"):
        bench.controller.start(reach(index=2))  # no state has come since
    bench.steps(0.05)
    assert np.abs(bench.arm.v).max() > 0.1
    with pytest.raises(TrajectoryError, match=r"still being braked; a trial starts from rest"):
        bench.controller.start(reach(index=2))
    bench.until(lambda b: not b.controller.braking)
    assert np.abs(bench.arm.v).max() < 0.05
    bench.controller.start(reach(index=2))
    assert bench.finish().outcome == Outcome.COMPLETED


@pytest.mark.parametrize("then", ["held_again", "next_trial"])
@pytest.mark.parametrize("lost_in", ["run", "hold", "stop"])
def test_an_arm_that_moved_while_nobody_held_it_is_not_pulled_back(lost_in: str, then: str) -> None:
    """Effort goes to zero without states: by the time they return, the arm is somewhere else."""
    bench = stopped() if lost_in == "stop" else in_run(0.5)
    if lost_in == "hold":
        bench.finish()
    bench.controller.lose_states(LOST)
    bench.arm.q, bench.arm.v = (0.2, 0.9), (0.0, 0.0)
    bench.time_ns += 3 * NS_PER_S
    if then == "next_trial":
        bench.until(lambda b: not b.controller.braking)
        bench.controller.start(reach(index=2))
    tick = bench.step()
    np.testing.assert_array_equal(tick.equilibrium_rad, (0.2, 0.9))
    np.testing.assert_array_equal(tick.effort_nm, 0.0)
