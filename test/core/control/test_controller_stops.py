"""Trials that end before their end: aborted, cancelled, or without states."""

from __future__ import annotations

import copy
import re
from collections.abc import Callable

import numpy as np
import pytest
from two_link import Bench, TwoLinkArm, in_run, loops, make_bench, reach, stopped

from tel_ros.core.arm_state import ArmState
from tel_ros.core.errors import TrajectoryError
from tel_ros.core.trial import Outcome, Phase
from tel_ros.core.types import NS_PER_S

COURSE = [Phase.APPROACH, Phase.SETTLE, Phase.RUN, Phase.HOLD]
AWAY = (1.2, 0.8)  # a posture apart from where the goals start
LOST = "no joint state for 0.1 s"


def off_its_path() -> Bench:
    bench = make_bench(control={"path_tolerance_rad": 0.1})
    bench.controller.start(loops(4.5))
    return bench


def too_fast() -> Bench:
    bench = in_run(0.3, description={"velocity_limit_rad_s": (3.0, 3.0)})
    bench.arm.v = (-3.5, 0.0)
    return bench


def beyond_a_joint_limit() -> Bench:
    bench = in_run(0.8, description={"position_max_rad": (0.95, 2.9)})
    bench.arm.v = (4.0, 0.0)
    return bench


def stamps_that_go_back() -> Bench:
    bench = in_run(0.5)
    bench.time_ns -= 102_000_000
    return bench


def a_gap_in_the_stamps() -> Bench:
    bench = in_run(0.5)
    bench.time_ns += 148_000_000
    return bench


SCENES = {
    off_its_path: r"(shoulder|elbow) is 0\.1\d\d rad off its desired position \(path tolerance 0\.100 rad\)",
    too_fast: r"shoulder moves at -3\.50 rad/s \(limit 3\.00 rad/s\)",
    beyond_a_joint_limit: r"shoulder is at 0\.9[56]\d rad \(limits -2\.900 to 0\.950 rad\)",
    stamps_that_go_back: r"the stamps of the joint states went back by 0\.100 s",
    a_gap_in_the_stamps: r"no joint state for 0\.150 s \(time-out 0\.1 s\)",
}
each_scene = pytest.mark.parametrize("scene", SCENES, ids=lambda scene: scene.__name__)


@each_scene
def test_the_trial_is_aborted_in_run_and_the_reason_given(scene: Callable[[], Bench]) -> None:
    bench = scene()
    report = bench.finish()
    assert report.outcome == Outcome.ABORTED
    assert re.fullmatch(SCENES[scene], report.message), report.message
    assert bench.phases() == [*COURSE[:3], Phase.STOP]
    error = (bench.position_rad - bench.column("desired_position_rad"))[bench.rows(Phase.RUN)]
    assert report.rms_error_rad == pytest.approx(np.sqrt(np.mean(error**2)), rel=1e-9)  # rounding


@each_scene
def test_from_the_abort_on_the_arm_is_only_braked_and_then_held(scene: Callable[[], Bench]) -> None:
    bench = scene()
    bench.finish()
    braking = bench.rows(Phase.STOP)
    q, soft = bench.position_rad, bench.controller.safety.soft_limits
    pushed_back = (q < soft.low_rad) | (q > soft.high_rad)
    power_w = np.where(pushed_back, 0.0, bench.column("effort_nm") * bench.velocity_rad_s)[braking]
    assert np.all(power_w <= 0.0)
    bench.steps(1.5)
    assert bench.controller.phase == Phase.STOP
    # Less than what counts as standing still during one window of rest, 0.05 rad/s × 0.2 s.
    assert np.ptp(bench.position_rad[-250:], axis=0).max() < 0.01
    assert bench.arm.kinetic_energy() < 1e-4
    assert np.all(np.abs(bench.column("effort_nm")) <= 20.0)


@each_scene
def test_a_new_trial_can_start_from_where_the_arm_stopped(scene: Callable[[], Bench]) -> None:
    bench = scene()
    bench.finish()
    n, held = len(bench.ticks), bench.ticks[-1].equilibrium_rad
    report = bench.run(reach(duration_s=3.0, index=2))  # slow enough for the narrow tolerance, too
    assert (report.outcome, report.index, report.message) == (Outcome.COMPLETED, 2, "")
    assert report.ticks == len(bench.ticks) - n
    assert bench.phases(n) == COURSE
    np.testing.assert_array_equal(bench.ticks[n].equilibrium_rad, held)


@pytest.mark.parametrize(
    ("pushed_in", "message"),
    [
        (Phase.SETTLE, "not at rest at the start posture after 1.0 s"),
        (Phase.HOLD, "not at rest after the movement after 1.0 s"),
    ],
)
def test_an_arm_that_does_not_come_to_rest_aborts_the_trial(pushed_in: Phase, message: str) -> None:
    bench = make_bench(control={"settle_timeout_s": 1.0})
    bench.controller.start(reach())
    bench.until_phase(pushed_in)
    bench.arm.push = lambda t: (2.0 * np.sin(6.0 * t), 0.0)
    bench.until_phase(Phase.STOP)
    stayed = bench.stamps_ns[bench.rows(pushed_in)]
    assert stayed[-1] - stayed[0] == pytest.approx(1.0 * NS_PER_S, abs=bench.period_ns)
    bench.arm.push = lambda t: (0.0, 0.0)
    report = bench.finish()
    assert (report.outcome, report.message) == (Outcome.ABORTED, message)
    assert np.isnan(report.rms_error_rad) == (pushed_in == Phase.SETTLE)


def test_a_trial_ends_even_if_the_arm_does_not_come_to_rest_under_the_brake() -> None:
    bench = in_run(0.5, control={"settle_timeout_s": 1.0})
    bench.controller.cancel()
    bench.arm.push = lambda t: (4.0 * np.sin(6.0 * t), 0.0)
    report = bench.finish()
    assert report.outcome == Outcome.CANCELLED
    assert report.message == "cancelled; it was not at rest under the brake after 1.0 s"


def test_an_arm_that_is_pushed_gently_stays_held_after_a_stop() -> None:
    bench = stopped()
    bench.steps(1.0)
    held, start_s = bench.position_rad[-1], bench.arm.time_s
    bench.arm.push = lambda t: (0.1 * min(1.0, t - start_s), -0.1 * min(1.0, t - start_s))
    bench.steps(3.0)
    # What springs of 15 N·m/rad give way under 0.1 N·m; 1 mrad for what of the stop was still to settle.
    np.testing.assert_allclose(bench.position_rad[-1] - held, (0.1 / 15, -0.1 / 15), atol=1e-3)


def test_a_stopped_arm_does_not_creep_with_the_noise_of_its_sensors() -> None:
    bench, rng = stopped(), np.random.default_rng(3)

    def commands(n: int) -> np.ndarray:
        u = []
        for _ in range(n):
            bench.time_ns += bench.period_ns
            noisy = np.array(bench.arm.q) + rng.normal(0.0, 1e-3, 2)
            tick = bench.controller.tick(ArmState(bench.time_ns, noisy, rng.normal(0.0, 0.3, 2)))
            u.append(tick.equilibrium_rad)
        return np.array(u)

    # Noise may unlatch it once more, as long as what it counts as its place of rest dates from the braking.
    assert np.ptp(commands(500), axis=0).max() < 0.01
    np.testing.assert_array_equal(np.ptp(commands(1000), axis=0), 0.0)


def test_a_final_stop_aborts_the_trial_and_lets_the_arm_go_once_it_is_at_rest() -> None:
    bench = in_run(0.5)
    bench.controller.stop_for("somebody pressed the button")
    assert not bench.controller.at_final_effort
    report = bench.finish()
    assert (report.outcome, report.message) == (Outcome.ABORTED, "somebody pressed the button")
    bench.until(lambda b: b.controller.at_final_effort, 1.0)
    bench.arm.q, n = (0.3, 0.5), len(bench.ticks)  # nobody holds it
    bench.steps(0.5)
    np.testing.assert_array_equal(bench.column("effort_nm")[n:], 0.0)


def test_after_a_final_stop_no_trial_starts_before_it_is_reset() -> None:
    bench = in_run(0.5)
    bench.controller.stop_for("button")
    bench.finish()
    bench.until(lambda b: b.controller.at_final_effort, 1.0)
    with pytest.raises(TrajectoryError, match="stopped: button; no trial starts before the stop is reset"):
        bench.controller.start(reach(index=2))
    bench.controller.reset_stop()
    assert bench.controller.phase == Phase.IDLE
    bench.arm.q, bench.arm.v = (0.3, 0.5), (0.0, 0.0)
    n = len(bench.ticks)
    assert bench.run(reach(index=2)).outcome == Outcome.COMPLETED
    np.testing.assert_array_equal(bench.ticks[n].effort_nm, 0.0)


def test_a_final_stop_holds_the_arm_if_it_is_configured_to() -> None:
    bench = in_run(0.5, safety={"final_effort": "hold"})
    bench.controller.stop_for("button")
    bench.until(lambda b: b.controller.at_final_effort)
    held = bench.position_rad[-1]
    bench.steps(0.5)
    start_s = bench.arm.time_s
    bench.arm.push = lambda t: (0.15 * min(1.0, t - start_s), 0.0)
    bench.steps(2.0)
    np.testing.assert_allclose(bench.position_rad[-1] - held, (0.15 / 15, 0.0), atol=3e-3)


def test_to_finish_cancels_the_trial_and_ends_at_the_final_effort() -> None:
    bench = in_run(0.5)
    bench.controller.finish()
    assert bench.finish().outcome == Outcome.CANCELLED
    bench.until(lambda b: b.controller.at_final_effort, 1.0)
    assert not bench.ticks[-1].effort_nm.any()


def test_to_finish_between_trials_lets_the_held_arm_go() -> None:
    bench = make_bench()
    report = bench.run(reach())
    bench.controller.finish()
    bench.until(lambda b: b.controller.at_final_effort)
    assert bench.controller.report is report
    assert not bench.ticks[-1].effort_nm.any()


def test_a_final_stop_of_an_arm_that_nobody_holds_commands_nothing() -> None:
    bench = make_bench()
    bench.controller.stop_for("button")
    assert bench.step() is None
    assert bench.controller.at_final_effort
    with pytest.raises(TrajectoryError, match="stopped: button"):
        bench.controller.start(reach())


def test_an_arm_that_was_let_go_is_not_taken_hold_of_when_states_return() -> None:
    bench = in_run(0.5)
    bench.controller.stop_for("button")
    bench.until(lambda b: b.controller.at_final_effort)
    bench.controller.lose_states(LOST)
    bench.time_ns += 3 * NS_PER_S
    bench.arm.v = (1.0, 0.0)
    bench.steps(0.2)
    np.testing.assert_array_equal(bench.ticks[-1].effort_nm, 0.0)


def test_an_effort_that_is_not_a_number_is_never_commanded() -> None:
    bench = in_run(0.5)
    springs = bench.controller._springs
    bench.controller._springs = broken = copy.copy(springs)
    object.__setattr__(broken, "stiffness_nm_per_rad", np.full(2, np.nan))
    assert bench.step().effort_nm.tolist() == [0.0, 0.0]
    assert bench.controller.phase == Phase.STOP
    bench.controller._springs = springs
    report = bench.finish()
    assert report.outcome == Outcome.ABORTED
    assert "expected 2 finite numbers" in report.message


def test_a_gap_between_trials_brakes_the_arm_and_leaves_the_report_alone() -> None:
    bench = make_bench()
    report = bench.run(reach())
    bench.time_ns += NS_PER_S
    assert bench.step().phase == Phase.STOP
    assert bench.controller.report is report
    assert report.outcome == Outcome.COMPLETED


@pytest.mark.parametrize("gap_s", [0.2, 3600.0])
def test_after_a_gap_a_trial_ends_when_the_arm_is_at_rest_and_not_when_the_clock_says_so(
    gap_s: float,
) -> None:
    bench = in_run(0.5)
    bench.time_ns += round(gap_s * NS_PER_S)
    report = bench.finish()
    assert report.outcome == Outcome.ABORTED
    assert "not at rest" not in report.message
    assert bench.arm.kinetic_energy() < 1e-3


def test_a_stop_in_which_the_stamps_go_back_still_ends() -> None:
    """The clock of an arm that restarts begins anew; the trial must not hang for that."""
    bench = make_bench(time_ns=1000 * NS_PER_S)
    bench.controller.start(reach())
    bench.until_phase(Phase.SETTLE)
    bench.steps(0.1)
    bench.controller.cancel()
    bench.steps(0.1)  # half of what it takes to count as at rest
    bench.time_ns = NS_PER_S
    assert bench.finish().outcome == Outcome.CANCELLED


@pytest.mark.parametrize("phase", COURSE, ids=lambda phase: phase.name)
def test_a_trial_can_be_cancelled_in_each_phase(phase: Phase) -> None:
    bench = make_bench(TwoLinkArm(q=AWAY))
    bench.controller.start(reach())
    bench.until_phase(phase)
    bench.steps(0.02)
    bench.controller.cancel()
    report = bench.finish()
    assert (report.outcome, report.message) == (Outcome.CANCELLED, "cancelled")
    assert bench.phases() == [*COURSE[: COURSE.index(phase) + 1], Phase.STOP]
    bench.steps(1.0)
    assert bench.arm.kinetic_energy() < 1e-4


def test_a_trial_that_is_cancelled_before_a_state_came_knows_when_it_began() -> None:
    bench = make_bench()
    bench.step()
    bench.controller.start(reach())
    bench.controller.cancel()
    report = bench.finish()
    assert report.outcome == Outcome.CANCELLED
    assert report.ticks == len(bench.ticks)
    assert report.start_ns == bench.stamps_ns[0]


def test_without_a_trial_cancelling_changes_nothing() -> None:
    bench = make_bench()
    bench.controller.cancel()
    assert bench.step() is None
    assert bench.controller.report is None


def test_an_abort_is_not_turned_into_a_cancellation() -> None:
    bench = too_fast()
    bench.until_phase(Phase.STOP)
    bench.controller.cancel()
    assert bench.finish().outcome == Outcome.ABORTED
