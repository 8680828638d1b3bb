"""Springs that change from trial to trial: bounded, and without a jump of the effort."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from two_link import TwoLinkArm, arm_config, make_bench, reach

from tel_ros.core.arm_state import ArmState
from tel_ros.core.errors import TrajectoryError
from tel_ros.core.springs import SpringChange, Springs
from tel_ros.core.trial import Outcome, Phase, TrialGoal

CONFIGURED = Springs.of(arm_config())
AWAY = (1.2, 0.8)


def stiff(factor: float, goal: TrialGoal | None = None) -> TrialGoal:
    """Return a goal for springs that are this much stiffer than the arm's."""
    return dataclasses.replace(goal or reach(), springs=CONFIGURED.scaled(factor))


@pytest.mark.parametrize("bad", [0.0, -1.0, np.nan, np.inf])
def test_a_stiffness_that_is_no_finite_number_above_zero_is_refused(bad: float) -> None:
    with pytest.raises(TrajectoryError, match="expected finite numbers, stiffness above 0"):
        Springs(np.array([15.0, bad]), np.ones(2))


@pytest.mark.parametrize("bad", [-1e-9, np.nan, np.inf])
def test_a_damping_that_is_no_finite_number_from_zero_is_refused(bad: float) -> None:
    with pytest.raises(TrajectoryError, match="damping of at least 0"):
        Springs(np.ones(2), np.array([1.5, bad]))


@pytest.mark.parametrize("shapes", [((2,), (3,)), ((2, 1), (2, 1)), ((), ())])
def test_stiffness_and_damping_have_one_value_a_joint(shapes: tuple[tuple[int, ...], ...]) -> None:
    with pytest.raises(TrajectoryError, match="one value a joint"):
        Springs(np.ones(shapes[0]), np.ones(shapes[1]))


def test_equal_springs_give_back_the_same_array() -> None:
    u = np.array([0.1, 0.2])
    assert CONFIGURED.equilibrium_for(Springs.of(arm_config()), u, np.ones(2), np.ones(2)) is u


def test_the_learned_equilibrium_exerts_with_the_configured_springs_what_was_exerted() -> None:
    used = CONFIGURED.scaled(4.0)
    u, q, v = np.random.default_rng(1).normal(size=(3, 40, 2))
    learned = SpringChange(used, CONFIGURED).learned(u, q, v)
    exerted = Springs(used.stiffness_nm_per_rad, used.damping_nms_per_rad).effort(u, q, v)
    would = Springs(CONFIGURED.stiffness_nm_per_rad, CONFIGURED.damping_nms_per_rad)
    np.testing.assert_allclose(would.effort(learned, q, v), exerted, atol=1e-9)


@pytest.mark.parametrize("factor", [10.1, 1 / 10.1])
def test_springs_beyond_the_bound_are_refused_and_nothing_starts(factor: float) -> None:
    bench = make_bench()
    with pytest.raises(TrajectoryError, match="stiffness is .* expected"):
        bench.controller.start(stiff(factor))
    assert not bench.controller.active
    assert bench.controller.phase == Phase.IDLE


def test_an_arm_cannot_lose_its_damping() -> None:
    bench = make_bench()
    undamped = Springs(CONFIGURED.stiffness_nm_per_rad, np.zeros(2))
    with pytest.raises(TrajectoryError, match="damping is \\[0.0, 0.0\\]"):
        bench.controller.start(dataclasses.replace(reach(), springs=undamped))


def test_springs_of_another_arm_are_refused() -> None:
    bench = make_bench()
    with pytest.raises(TrajectoryError, match="stiffness is"):
        bench.controller.start(dataclasses.replace(reach(), springs=Springs(np.ones(3), np.ones(3))))


def test_the_bound_is_that_of_the_configuration_and_can_be_asked_for() -> None:
    bench = make_bench(control={"max_stiffness_factor": 3.0})
    with pytest.raises(TrajectoryError, match="stiffness"):
        bench.controller.start(stiff(3.01))
    bench.controller.start(stiff(3.0))
    assert bench.controller.active


@pytest.mark.parametrize(("before", "after"), [(1.0, 6.0), (10.0, 1.0), (1.0, 0.5)])
def test_the_effort_does_not_jump_when_the_springs_change(before: float, after: float) -> None:
    """Even if the arm is moving, and its springs are strained, because somebody pushes it."""
    bench = make_bench(TwoLinkArm(q=AWAY))
    offset = dataclasses.replace(reach(), equilibrium_rad=reach().equilibrium_rad + (0.1, -0.05))
    bench.run(stiff(before, offset))
    controller, last = bench.controller, bench.ticks[-1]
    pushed = ArmState(bench.states[-1].time_ns + 2_000_000, np.array([0.95, 1.05]), np.array([0.3, -0.2]))
    for _ in range(10):  # as long as the effort takes to grow to what the push calls for
        pushed = dataclasses.replace(pushed, time_ns=pushed.time_ns + 2_000_000)
        held = controller.tick(pushed)
        assert held is not None and controller.phase == Phase.HOLD
    np.testing.assert_array_equal(held.equilibrium_rad, last.equilibrium_rad)
    assert np.abs(held.effort_nm).min() > 0.01
    controller.start(stiff(after, reach(index=2)))
    next_state = dataclasses.replace(pushed, time_ns=pushed.time_ns + 2_000_000)
    taken_up = controller.tick(next_state)
    assert taken_up is not None and controller.phase == Phase.APPROACH
    np.testing.assert_allclose(taken_up.effort_nm, held.effort_nm, atol=1e-9)
    assert np.any(np.abs(taken_up.equilibrium_rad - held.equilibrium_rad) > 1e-3)


def test_springs_too_soft_for_what_is_held_end_the_trial_under_the_brake() -> None:
    """What takes 0.3 rad of strain with stiff springs would take several rad with soft ones."""
    bench = make_bench()
    bench.run(stiff(9.0))
    bench.arm.q = (0.6, 1.0)
    bench.controller.start(stiff(0.5, reach(index=2)))
    report = bench.finish()
    assert report.outcome == Outcome.ABORTED
    assert "path tolerance" in report.message


def test_in_a_trial_the_effort_is_that_of_its_springs() -> None:
    bench = make_bench()
    assert bench.run(stiff(4.0)).outcome == Outcome.COMPLETED
    run = bench.rows(Phase.RUN)
    u, q, v = (x[run] for x in (bench.column("equilibrium_rad"), bench.position_rad, bench.velocity_rad_s))
    k, b = 4.0 * CONFIGURED.stiffness_nm_per_rad, 2.0 * CONFIGURED.damping_nms_per_rad
    np.testing.assert_allclose(bench.column("effort_nm")[run], k * (u - q) - b * v, atol=1e-9)


def test_a_trial_that_does_not_ask_for_springs_has_the_configured_ones_again() -> None:
    bench = make_bench()
    bench.run(stiff(4.0))
    n = len(bench.ticks)
    bench.run(reach(index=2))
    run = [row for row in bench.rows(Phase.RUN) if row >= n]
    u, q, v = (x[run] for x in (bench.column("equilibrium_rad"), bench.position_rad, bench.velocity_rad_s))
    expected = CONFIGURED.stiffness_nm_per_rad * (u - q) - CONFIGURED.damping_nms_per_rad * v
    np.testing.assert_allclose(bench.column("effort_nm")[run], expected, atol=1e-9)


def test_after_an_abort_the_springs_of_the_trial_brake_and_never_push() -> None:
    bench = make_bench()
    bench.controller.start(stiff(4.0))
    bench.until(lambda b: b.controller.time_from_start_s >= 0.4)
    bench.controller.cancel()
    assert bench.finish().outcome == Outcome.CANCELLED
    stop = bench.rows(Phase.STOP)
    effort, v = bench.column("effort_nm")[stop], bench.velocity_rad_s[stop]
    u, q = bench.column("equilibrium_rad")[stop], bench.position_rad[stop]
    k, b = 4.0 * CONFIGURED.stiffness_nm_per_rad, 2.0 * CONFIGURED.damping_nms_per_rad
    np.testing.assert_allclose(effort, k * (u - q) - b * v, atol=1e-9)
    moving = np.abs(v) > 0.05
    assert moving.any()
    assert np.all((effort * v)[moving] <= 0.0)


def test_a_trial_cancelled_before_its_first_state_leaves_the_springs_as_they_were() -> None:
    bench = make_bench()
    bench.run(reach())
    bench.controller.start(stiff(9.0, reach(index=2)))
    bench.controller.cancel()
    n = len(bench.ticks)
    bench.finish()
    stop = np.arange(n, len(bench.ticks))
    u, q, v = (x[stop] for x in (bench.column("equilibrium_rad"), bench.position_rad, bench.velocity_rad_s))
    expected = CONFIGURED.stiffness_nm_per_rad * (u - q) - CONFIGURED.damping_nms_per_rad * v
    np.testing.assert_allclose(bench.column("effort_nm")[stop], expected, atol=1e-9)


def test_the_effort_is_that_of_a_spring_and_a_damper_at_each_joint_and_has_no_limit() -> None:
    springs = Springs(np.array([15.0, 10.0]), np.array([1.5, 0.5]))
    effort = springs.effort(np.array([1.0, 0.2]), np.array([0.4, 0.5]), np.array([2.0, -1.0]))
    np.testing.assert_allclose(effort, [15.0 * 0.6 - 1.5 * 2.0, 10.0 * -0.3 + 0.5 * 1.0], atol=1e-14)
    assert springs.effort(np.array([100.0, 0.0]), np.zeros(2), np.zeros(2)).tolist() == [1500.0, 0.0]
