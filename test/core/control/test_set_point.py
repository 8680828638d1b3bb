"""What a position drive is sent, whatever the control law asks for."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from two_link import arm_config, loops, make_bench, reach

from tel_ros.core.arm_state import ArmState
from tel_ros.core.config import ArmConfig
from tel_ros.core.control.set_point import SetPointGuard
from tel_ros.core.errors import TrajectoryError
from tel_ros.core.springs import Springs
from tel_ros.core.trial import Outcome, Phase
from tel_ros.core.types import NS_PER_S, FloatArray

PERIOD_NS = 2_000_000
POSITION = {"command_interface": "position"}
Q = np.array([0.3, -0.4])
STILL = np.zeros(2)


def state(tick: int, q: FloatArray = Q, v: FloatArray = STILL) -> ArmState:
    return ArmState(tick * PERIOD_NS, q, v)


@pytest.fixture
def arm() -> ArmConfig:
    return arm_config(**POSITION, set_point_speed_rad_s=(2.0, 5.0))


@pytest.fixture
def guard(arm: ArmConfig) -> SetPointGuard:
    """Return a guard that has sent the posture once."""
    guard = SetPointGuard(arm, longest_gap_s=0.1)
    guard.follow(Q, state(0))
    return guard


def settled(guard: SetPointGuard, asked: FloatArray, **now: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Ask for the same for so long that speed does not matter any more."""
    for tick in range(1, 2000):
        sent, changed = guard.follow(asked, state(tick, **now))
    return sent, changed


def test_what_is_slow_and_within_the_limits_is_sent_bit_by_bit(guard: SetPointGuard) -> None:
    rng = np.random.default_rng(3)
    asked = Q.copy()
    for tick in range(1, 500):
        asked = asked + rng.uniform(-1.0, 1.0, 2) * [0.0039, 0.0099]
        sent, changed = guard.follow(asked, state(tick))
        np.testing.assert_array_equal(sent, asked)
        assert not changed.any()


def test_a_jump_is_followed_at_the_speed_that_is_allowed(guard: SetPointGuard) -> None:
    asked = Q + [0.5, -0.5]
    path = np.array([guard.follow(asked, state(tick))[0] for tick in range(1, 300)])
    steps = np.diff(np.vstack([Q, path]), axis=0) * NS_PER_S / PERIOD_NS
    assert np.abs(steps).max(axis=0) == pytest.approx([2.0, 5.0])
    np.testing.assert_array_equal(path[-1], asked)


def test_what_was_held_back_is_said(guard: SetPointGuard) -> None:
    sent, changed = guard.follow(Q + [0.5, 0.001], state(1))
    assert changed.tolist() == [True, False]
    assert sent == pytest.approx(Q + [0.004, 0.001])


@pytest.mark.parametrize(("gap_s", "allowed_s"), [(0.05, 0.05), (0.4, 0.1), (0.0, 0.0), (-3.0, 0.0)])
def test_a_gap_in_the_states_allows_no_longer_way_than_the_time_out(
    guard: SetPointGuard, gap_s: float, allowed_s: float
) -> None:
    late = ArmState(round(gap_s * NS_PER_S), Q, STILL)
    sent, _ = guard.follow(Q + 1.0, late)
    assert sent == pytest.approx(Q + allowed_s * np.array([2.0, 5.0]))


def test_the_springs_are_never_asked_for_more_than_the_limit(guard: SetPointGuard, arm: ArmConfig) -> None:
    sent, changed = settled(guard, Q + [9.0, -9.0])
    effort = np.array(arm.stiffness_nm_per_rad) * (sent - Q)
    assert effort == pytest.approx(np.array(arm.effort_limit_nm) * [1.0, -1.0])
    assert changed.all()


def test_an_effort_that_is_within_the_limit_in_motion_is_not_cut_to_what_it_would_be_at_rest(
    guard: SetPointGuard, arm: ArmConfig
) -> None:
    """At 3 rad/s the dampers take 4.5 N·m away: the springs may pull with that much more."""
    v = np.array([3.0, 3.0])
    k, b = np.array(arm.stiffness_nm_per_rad), np.array(arm.damping_nms_per_rad)
    at_the_limit = Q + (np.array(arm.effort_limit_nm) * 0.999 + b * v) / k
    np.testing.assert_array_equal(settled(guard, at_the_limit, v=v)[0], at_the_limit)
    beyond = Q + (np.array(arm.effort_limit_nm) * 1.01 + b * v) / k
    assert np.all(settled(guard, beyond, v=v)[0] < beyond)


def test_a_fast_arm_does_not_take_a_braking_spring_along(guard: SetPointGuard) -> None:
    """B q̇ alone exceeds the limit: the drive clips that, and the set point stays behind."""
    sent, changed = settled(guard, Q, v=np.array([14.0, 14.0]))
    np.testing.assert_array_equal(sent, Q)
    assert not changed.any()


def test_set_points_leave_the_range_only_as_far_as_springs_need(arm: ArmConfig) -> None:
    guard = SetPointGuard(arm, longest_gap_s=0.1)
    q = np.array(arm.position_max_rad)
    guard.follow(q, state(0, q))
    far_rad, changed = settled(guard, q + 50.0, q=q + 20.0)  # an encoder that has gone mad
    k, b = np.array(arm.stiffness_nm_per_rad), np.array(arm.damping_nms_per_rad)
    most = (np.array(arm.effort_limit_nm) + b * arm.velocity_limit_rad_s) / k
    assert far_rad == pytest.approx(q + most)
    assert changed.all()


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_what_is_not_a_number_is_not_followed(guard: SetPointGuard, bad: float) -> None:
    sent, changed = guard.follow(np.array([bad, Q[1]]), state(1))
    np.testing.assert_array_equal(sent, Q)
    assert changed.tolist() == [True, False]


def test_the_speed_limit_of_the_joints_is_that_of_set_points_unless_told_otherwise() -> None:
    guard = SetPointGuard(arm_config(**POSITION, velocity_limit_rad_s=(1.0, 3.0)), longest_gap_s=0.1)
    guard.follow(Q, state(0))
    assert guard.follow(Q + 0.5, state(1))[0] == pytest.approx(Q + [0.002, 0.006])


def test_with_either_interface_the_controller_does_the_same_where_nothing_is_held_back() -> None:
    with_effort, with_position = make_bench(), make_bench(description=POSITION)
    assert with_effort.run(loops(4.5)).outcome == with_position.run(loops(4.5)).outcome == Outcome.COMPLETED
    for name in ("equilibrium_rad", "effort_nm", "saturated"):
        np.testing.assert_array_equal(with_effort.column(name), with_position.column(name))


def drop_out(bench) -> None:  # noqa: ANN001
    bench.controller.lose_states("no joint state")
    bench.time_ns += NS_PER_S


@pytest.mark.parametrize(
    "trouble", [lambda bench: bench.controller.cancel(), drop_out], ids=["cancel", "gap"]
)
def test_set_points_do_not_jump_when_a_trial_is_stopped(trouble: Callable[..., None]) -> None:
    bench = make_bench(description={**POSITION, "set_point_speed_rad_s": (4.0, 4.0)})
    bench.controller.start(reach(duration_s=0.5))
    bench.until(lambda b: b.controller.time_from_start_s >= 0.2)
    trouble(bench)
    bench.steps(3.0)
    steps = np.abs(np.diff(bench.column("equilibrium_rad"), axis=0)).max(axis=1)
    gaps_s = np.minimum(np.diff(bench.stamps_ns) / NS_PER_S, 0.1)
    assert np.all(steps <= 4.0 * gaps_s + 1e-12)
    assert bench.controller.phase == Phase.STOP
    assert np.abs(bench.velocity_rad_s[-1]).max() < 0.05


def test_a_command_that_moves_too_fast_counts_as_one_that_did_not_act() -> None:
    bench = make_bench(description={**POSITION, "set_point_speed_rad_s": (0.4, 0.4)})
    bench.run(reach(duration_s=1.0))
    run = bench.rows(Phase.RUN)
    assert bench.column("saturated")[run].any()
    assert bench.controller.report is not None and bench.controller.report.saturated_ratio > 0.0


def test_springs_of_its_own_are_refused_in_a_goal_for_drives_that_have_theirs() -> None:
    bench = make_bench(description=POSITION)
    configured = Springs.of(arm_config(**POSITION))
    plain = reach()
    own = type(plain)(1, 1.0, plain.desired, plain.equilibrium_rad, configured.scaled(2.0))
    with pytest.raises(TrajectoryError, match="expected none: they are the drive's"):
        bench.controller.start(own)
    bench.controller.start(type(own)(1, 1.0, plain.desired, plain.equilibrium_rad, configured))
    assert bench.controller.active
