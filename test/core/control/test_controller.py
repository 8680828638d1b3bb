"""The course of a trial in which nothing goes wrong, on a two-link arm in formulas."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from two_link import Bench, TwoLinkArm, loops, make_bench, reach

from tel_ros.core.errors import TrajectoryError
from tel_ros.core.trial import Outcome, Phase
from tel_ros.core.types import NS_PER_S

COURSE = [Phase.APPROACH, Phase.SETTLE, Phase.RUN, Phase.HOLD]
AWAY = (1.2, 0.8)  # a posture apart from where the goals start


def run_until(bench: Bench, time_s: float, goal: object = None) -> None:
    """Start a trial and go on to some time after the beginning of RUN."""
    bench.controller.start(goal or reach())
    bench.until(lambda b: b.controller.time_from_start_s >= time_s)
    assert bench.controller.phase == Phase.RUN


def test_before_the_first_trial_nothing_is_commanded() -> None:
    bench = make_bench()
    assert bench.step() is None
    assert bench.controller.phase == Phase.IDLE
    assert not bench.controller.active


def test_a_trial_goes_through_its_phases_in_order_and_is_completed(loops_trial: Bench) -> None:
    assert loops_trial.phases() == COURSE
    report = loops_trial.controller.report
    assert report.outcome == Outcome.COMPLETED
    assert report.message == ""
    assert not loops_trial.controller.active


def test_the_report_counts_the_ticks_and_knows_its_stamps(loops_trial: Bench) -> None:
    report, stamps = loops_trial.controller.report, loops_trial.stamps_ns
    assert report.ticks == len(stamps)
    assert report.start_ns == stamps[0]
    assert report.run_ns == stamps[loops_trial.rows(Phase.RUN)[0]]
    assert report.end_ns == stamps[-1]
    assert report.duration_s == 4.5


def test_run_lasts_exactly_as_long_as_the_desired_trajectory(loops_trial: Bench) -> None:
    run = loops_trial.stamps_ns[loops_trial.rows(Phase.RUN)]
    assert run[-1] - run[0] == 4_500_000_000


def test_time_from_start_is_negative_before_run_and_counts_from_its_first_tick(loops_trial: Bench) -> None:
    times = np.array([tick.time_from_start_s for tick in loops_trial.ticks])
    run = loops_trial.rows(Phase.RUN)
    assert np.all(times[: run[0]] < 0.0)
    np.testing.assert_allclose(times[run[0] :], np.arange(len(times) - run[0]) / 500.0, atol=1e-12)


def test_the_tracking_error_is_that_of_the_measured_states_over_run(loops_trial: Bench) -> None:
    run = loops_trial.rows(Phase.RUN)
    desired = loops(4.5).desired
    t = loops_trial.stamps_ns[run] - loops_trial.stamps_ns[run[0]]
    y = np.column_stack([np.interp(t, desired.time_ns, column) for column in desired.position_rad.T])
    error = loops_trial.position_rad[run] - y
    report = loops_trial.controller.report
    # Sums in another order: rounding.
    np.testing.assert_allclose(report.rms_error_rad, np.sqrt(np.mean(error**2)), rtol=1e-9)
    per_joint = np.sqrt(np.mean(error**2, axis=0))
    np.testing.assert_allclose(report.rms_error_per_joint_rad, per_joint, rtol=1e-9)
    np.testing.assert_allclose(report.max_error_rad, np.abs(error).max(), rtol=1e-9)
    assert report.rms_error_rad > 0.1, "there is too little of an error to tell it from another one"


def test_effort_and_saturation_of_the_report_are_those_of_run() -> None:
    bench = make_bench(description={"effort_limit_nm": (0.8, 0.2)})
    report = bench.run(reach(duration_s=0.5))
    run = bench.rows(Phase.RUN)
    np.testing.assert_array_equal(report.max_effort_nm, np.abs(bench.column("effort_nm")[run]).max(axis=0))
    saturated = bench.column("saturated")[run]
    assert 0.0 < report.saturated_ratio < 1.0
    assert report.saturated_ratio == pytest.approx(np.mean(saturated.any(axis=1)))


def test_the_desired_state_of_run_is_the_goal_at_that_time(loops_trial: Bench) -> None:
    run, goal = loops_trial.rows(Phase.RUN), loops(4.5)
    for column, values in [
        ("desired_position_rad", goal.desired.position_rad),
        ("desired_velocity_rad_s", goal.desired.velocity_rad_s),
        ("desired_acceleration_rad_s2", goal.desired.acceleration_rad_s2),
        ("equilibrium_rad", goal.equilibrium_rad),
    ]:
        np.testing.assert_array_equal(loops_trial.column(column)[run], values)


def test_a_command_may_start_and_end_beside_the_desired_position() -> None:
    """As it does against gravity: the errors are those of the arm and not of the command."""
    goal = reach()
    goal = dataclasses.replace(goal, equilibrium_rad=goal.equilibrium_rad + (0.1, -0.05))
    bench = make_bench(TwoLinkArm(q=AWAY))
    report = bench.run(goal)
    settle, hold = bench.rows(Phase.SETTLE), bench.rows(Phase.HOLD)
    u, y = bench.column("equilibrium_rad"), bench.column("desired_position_rad")
    np.testing.assert_allclose(u[settle] - y[settle], [(0.1, -0.05)] * len(settle), atol=1e-12)
    np.testing.assert_allclose(u[hold] - y[hold], [(0.1, -0.05)] * len(hold), atol=1e-12)
    np.testing.assert_array_equal(y[settle], [goal.desired.position_rad[0]] * len(settle))
    # An arm at rest stands at the equilibrium point: the offset is the error at both ends of RUN.
    assert report.max_error_rad >= 0.1 - 0.01
    np.testing.assert_allclose(
        bench.position_rad[bench.rows(Phase.RUN)[0]] - (0.6, 1.3), (0.1, -0.05), atol=0.01
    )


def test_the_end_posture_is_held_after_the_trial(loops_trial: Bench) -> None:
    hold = loops_trial.rows(Phase.HOLD)
    end = loops(4.5).desired.position_rad[-1]
    np.testing.assert_array_equal(loops_trial.column("desired_position_rad")[hold], [end] * len(hold))
    bench = make_bench()
    bench.run(reach())
    n = len(bench.ticks)
    bench.steps(1.0)
    assert [tick.phase for tick in bench.ticks[n:]] == [Phase.HOLD] * 500
    # Less than what counts as standing still during one window of rest, 0.05 rad/s × 0.2 s.
    np.testing.assert_allclose(bench.position_rad[-1], (0.9, 1.0), atol=0.01)


def test_the_arm_is_at_rest_at_the_start_posture_before_run_begins() -> None:
    bench = make_bench(TwoLinkArm(q=AWAY))
    bench.run(reach())
    first = bench.rows(Phase.RUN)[0]
    before = bench.position_rad[first - 99 : first + 1]
    assert np.ptp(before, axis=0).max() <= 0.02
    np.testing.assert_allclose(before[-1], (0.6, 1.3), atol=0.03)


@pytest.mark.parametrize("limit_nm", [(20.0, 20.0), (3.0, 1.5)])
def test_the_effort_never_exceeds_the_limit(limit_nm: tuple[float, float]) -> None:
    bench = make_bench(
        TwoLinkArm(q=AWAY), description={"effort_limit_nm": limit_nm}, control={"path_tolerance_rad": 0.25}
    )
    bench.run(reach(duration_s=0.3))  # too fast for the weak arm: a stop is part of its course
    assert np.all(np.abs(bench.column("effort_nm")) <= limit_nm)


def test_the_effort_is_the_control_law_of_what_the_tick_says(loops_trial: Bench) -> None:
    wanted = 15.0 * (loops_trial.column("equilibrium_rad") - loops_trial.position_rad)
    wanted -= 1.5 * loops_trial.velocity_rad_s
    np.testing.assert_allclose(loops_trial.column("effort_nm"), np.clip(wanted, -20.0, 20.0), atol=1e-12)


def test_the_course_is_the_same_with_an_encoder_of_16_bits() -> None:
    bench = make_bench(TwoLinkArm(q=AWAY), encoder_rad=2 * np.pi / 2**16)
    assert bench.run(reach()).outcome == Outcome.COMPLETED
    assert bench.phases() == COURSE


@pytest.fixture(scope="module")
def two_trials() -> Bench:
    """Two movements one after the other, the second from another posture."""
    bench = make_bench(TwoLinkArm(q=AWAY))
    bench.run(reach((0.6, 1.3), (0.9, 1.0)))
    bench.steps(0.3)
    bench.run(reach((-0.2, 0.4), (0.3, 0.9), index=2))
    return bench


def test_the_equilibrium_point_moves_no_faster_than_the_trajectories_do(two_trials: Bench) -> None:
    assert two_trials.phases() == COURSE * 2
    jumps = np.abs(np.diff(two_trials.column("equilibrium_rad"), axis=0)).max(axis=1)
    running = [Phase.RUN, Phase.HOLD]  # the first tick of HOLD is at the end of the last interval of RUN
    in_run = np.isin([tick.phase for tick in two_trials.ticks[1:]], running)
    fastest_run = np.abs(np.diff(reach((-0.2, 0.4), (0.3, 0.9)).equilibrium_rad, axis=0)).max()
    assert jumps[in_run].max() <= fastest_run + 1e-12
    assert jumps[~in_run].max() <= 0.5 / 500.0 + 1e-12, "faster than approach_speed_rad_s"


def test_the_first_approach_starts_where_the_arm_is(two_trials: Bench) -> None:
    np.testing.assert_array_equal(two_trials.ticks[0].equilibrium_rad, AWAY)
    np.testing.assert_array_equal(two_trials.ticks[0].effort_nm, 0.0)


def test_the_second_approach_starts_from_what_is_held(two_trials: Bench) -> None:
    approach = two_trials.rows(Phase.APPROACH)
    (second,) = approach[1:][np.diff(approach) > 1]
    np.testing.assert_array_equal(two_trials.ticks[second].equilibrium_rad, (0.9, 1.0))


def test_the_approach_peaks_at_its_speed(two_trials: Bench) -> None:
    in_approach = np.diff(two_trials.rows(Phase.APPROACH)) == 1
    u = two_trials.column("equilibrium_rad")[two_trials.rows(Phase.APPROACH)]
    speed = np.abs(np.diff(u, axis=0))[in_approach].max() * 500.0
    assert speed == pytest.approx(0.5, rel=1e-3)  # the peak lies between two ticks


def test_an_arm_that_is_there_already_still_takes_half_a_second() -> None:
    bench = make_bench(TwoLinkArm(q=(0.6, 1.3)))
    bench.run(reach())
    assert len(bench.rows(Phase.APPROACH)) == 250


def course_of(bench: Bench) -> tuple[list[Phase], np.ndarray, np.ndarray]:
    bench.run(reach())
    return (
        [tick.phase for tick in bench.ticks],
        bench.column("effort_nm"),
        np.array([tick.time_from_start_s for tick in bench.ticks]),
    )


@pytest.mark.parametrize("start_ns", [0, 1_752_000_000_123_456_789], ids=["from_zero", "since_1970"])
def test_the_course_does_not_depend_on_when_time_began(start_ns: int) -> None:
    phases, effort_nm, times_s = course_of(make_bench(TwoLinkArm(q=AWAY)))
    same = course_of(make_bench(TwoLinkArm(q=AWAY), time_ns=start_ns))
    assert same[0] == phases
    np.testing.assert_array_equal(same[1], effort_nm)
    np.testing.assert_array_equal(same[2], times_s)


@pytest.mark.parametrize("period_ns", [4_000_000, 3_141_593])
def test_the_course_is_the_same_at_another_rate_of_states(period_ns: int) -> None:
    usual, other = make_bench(TwoLinkArm(q=AWAY)), make_bench(TwoLinkArm(q=AWAY), period_ns=period_ns)
    report, report_other = usual.run(reach()), other.run(reach())
    assert other.phases() == COURSE
    for bench, ns in ((usual, 2_000_000), (other, period_ns)):
        run = bench.stamps_ns[bench.rows(Phase.RUN)]
        assert NS_PER_S - ns < run[-1] - run[0] <= NS_PER_S
    # A command is held for up to 2 ms longer: 1 ms more of mean delay, at a peak speed of 0.6 rad/s.
    assert report_other.rms_error_rad == pytest.approx(report.rms_error_rad, abs=6e-4)
    approach_s = [len(b.rows(Phase.APPROACH)) * b.period_ns / NS_PER_S for b in (usual, other)]
    assert approach_s[1] == pytest.approx(approach_s[0], abs=0.005)


def test_between_the_points_of_a_coarse_goal_the_command_is_interpolated() -> None:
    bench = make_bench()
    goal = reach(rate_hz=20.0)
    bench.run(goal)
    run = bench.rows(Phase.RUN)
    t = (bench.stamps_ns[run] - bench.stamps_ns[run[0]]).astype(float)
    for name, points in [
        ("equilibrium_rad", goal.equilibrium_rad),
        ("desired_velocity_rad_s", goal.desired.velocity_rad_s),
    ]:
        expected = np.column_stack([np.interp(t, goal.desired.time_ns, c) for c in points.T])
        np.testing.assert_allclose(bench.column(name)[run], expected, atol=1e-12)


def test_a_missed_state_within_the_time_out_does_no_harm() -> None:
    bench = make_bench()
    run_until(bench, 0.4)
    bench.arm.step(bench.ticks[-1].effort_nm, 0.098)  # the last command keeps acting
    bench.time_ns += 98_000_000 - bench.period_ns
    bench.step()
    assert bench.controller.phase == Phase.RUN
    elapsed_ns = bench.stamps_ns[-1] - bench.stamps_ns[bench.rows(Phase.RUN)[0]]
    assert bench.ticks[-1].time_from_start_s == pytest.approx(elapsed_ns / NS_PER_S)


def test_a_second_trial_is_refused_while_one_is_under_way() -> None:
    bench = make_bench()
    run_until(bench, 0.2)
    with pytest.raises(TrajectoryError, match="another trial is under way; one trial at a time"):
        bench.controller.start(reach(index=2))
    assert bench.controller.goal.index == 1
    assert bench.finish().outcome == Outcome.COMPLETED


def test_a_goal_beyond_the_limits_is_refused_and_nothing_moves() -> None:
    bench = make_bench()
    with pytest.raises(
        TrajectoryError, match="shoulder should be at 2.9.* rad .*expected -2.900 to 2.900 rad"
    ):
        bench.controller.start(reach((0.6, 1.3), (3.0, 1.0)))
    assert bench.step() is None
    assert not bench.controller.active


def test_a_refused_goal_leaves_the_last_report_and_the_hold_alone() -> None:
    bench = make_bench()
    report = bench.run(reach())
    goal = reach()
    velocity = goal.desired.velocity_rad_s.copy()
    velocity[0] = 0.1
    moving = dataclasses.replace(goal, desired=dataclasses.replace(goal.desired, velocity_rad_s=velocity))
    with pytest.raises(TrajectoryError, match="expected rest"):
        bench.controller.start(moving)
    assert bench.controller.report is report
    assert bench.step().phase == Phase.HOLD
