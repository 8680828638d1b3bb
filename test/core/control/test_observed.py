"""Efforts of trajectories, and what is found wrong before one is sent."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from two_link import arm_config, reach

from tel_ros.core.arm_state import ArmState
from tel_ros.core.config import ArmConfig, ControlConfig, SafetyConfig
from tel_ros.core.control.controller import EpController
from tel_ros.core.control.observed import ObservedController
from tel_ros.core.control.trajectory_points import TrajectoryPoints, thinned
from tel_ros.core.errors import TrajectoryError
from tel_ros.core.springs import Springs
from tel_ros.core.trial import Phase, TrialGoal
from tel_ros.core.types import NS_PER_S

PERIOD_S = 0.002
PERIOD_NS = 2_000_000
NO_LIMIT = np.full(2, np.inf)


@pytest.fixture
def arm() -> ArmConfig:
    return arm_config(command_interface="trajectory")


def random_states(n: int) -> list[np.ndarray]:
    rng = np.random.default_rng(7)
    return [rng.normal(size=(n, 2)) for _ in range(6)]


def test_with_the_gains_k_and_b_the_efforts_make_the_law_of_practice_in_any_state(arm: ArmConfig) -> None:
    springs, n = Springs.of(arm), 200
    y, dy, ddy, u, q, dq = random_states(n)
    time_ns = np.arange(n, dtype=np.int64) * PERIOD_NS
    points = TrajectoryPoints.of(
        springs, time_ns, (y, dy, ddy), u, limit_nm=NO_LIMIT, periods_s=(PERIOD_S, PERIOD_S), lost_rad=0.0
    )
    assert len(points.time_ns) == n + 1
    # What a controller of the same rate adds up: efforts of the next point, errors of this one.
    p, d = springs.stiffness_nm_per_rad, springs.damping_nms_per_rad
    commanded = (
        points.effort_nm[1:] + p * (points.position_rad[:-1] - q) + d * (points.velocity_rad_s[:-1] - dq)
    )
    np.testing.assert_allclose(commanded, springs.effort(u, q, dq), atol=1e-9)


@pytest.mark.parametrize("rate_hz", [250.0, 1000.0, 2000.0])
def test_efforts_come_half_of_both_periods_later(arm: ArmConfig, rate_hz: float) -> None:
    springs, n = Springs.of(arm), 500
    time_ns = np.arange(n, dtype=np.int64) * PERIOD_NS
    still = np.zeros((n, 2))
    u = np.column_stack([time_ns / NS_PER_S, -time_ns / NS_PER_S])
    periods_s = PERIOD_S, 1.0 / rate_hz
    points = TrajectoryPoints.of(
        springs, time_ns, (still, still, still), u, limit_nm=NO_LIMIT, periods_s=periods_s, lost_rad=1e-9
    )
    at_s = 0.4
    later = np.interp(at_s * NS_PER_S, points.time_ns, points.effort_nm[:, 0])
    assert later == pytest.approx(15.0 * (at_s - 0.5 * sum(periods_s)))


def test_efforts_keep_within_the_limits_that_the_arm_has(arm: ArmConfig) -> None:
    n = 50
    time_ns, still = np.arange(n, dtype=np.int64) * PERIOD_NS, np.zeros((n, 2))
    points = TrajectoryPoints.of(
        Springs.of(arm),
        time_ns,
        (still, still, still),
        still + [9.0, -9.0],
        limit_nm=np.array([2.0, 3.0]),
        periods_s=(PERIOD_S, PERIOD_S),
        lost_rad=1e-5,
    )
    np.testing.assert_array_equal(points.effort_nm, np.tile([2.0, -3.0], (len(points.time_ns), 1)))


def test_a_rest_before_a_movement_is_in_its_first_point_with_its_effort(arm: ArmConfig) -> None:
    n = 20
    y, dy, ddy, u, _, _ = random_states(n)
    springs, time_ns = Springs.of(arm), np.arange(n, dtype=np.int64) * PERIOD_NS
    movement = TrajectoryPoints.of(
        springs, time_ns, (y, dy, ddy), u, limit_nm=NO_LIMIT, periods_s=(PERIOD_S, PERIOD_S), lost_rad=0.0
    )
    points = movement.after(100_000_000, PERIOD_NS)
    assert points.time_ns[:3].tolist() == [0, 98_000_000, 100_000_000]
    np.testing.assert_array_equal(points.time_ns[2:], movement.time_ns + 100_000_000)
    for k in range(2):
        np.testing.assert_array_equal(points.position_rad[k], y[0])
        np.testing.assert_array_equal(points.effort_nm[k], movement.effort_nm[0])
        assert not (points.velocity_rad_s[k].any() or points.acceleration_rad_s2[k].any())
    np.testing.assert_array_equal(points.velocity_rad_s[2:], movement.velocity_rad_s)


def test_points_are_left_out_only_as_far_as_lines_between_them_allow() -> None:
    time_ns = np.arange(500, dtype=np.int64)
    values = np.sin(np.linspace(0.0, 6.0, 500))[:, None]
    kept = thinned(time_ns, values, 1e-3)
    assert len(kept) < 100
    assert np.max(np.abs(np.interp(time_ns, time_ns[kept], values[kept, 0]) - values[:, 0])) <= 1e-3


def test_efforts_that_grow_faster_than_they_may_are_refused_before_anything_moves(arm: ArmConfig) -> None:
    goal = reach()
    sudden = goal.equilibrium_rad.copy()
    sudden[200:, 1] += 0.1  # 1.5 N·m
    goal = replace(goal, equilibrium_rad=sudden)
    EpController(arm, ControlConfig()).start(goal)
    ObservedController(arm, ControlConfig()).start(goal)
    slow = SafetyConfig(effort_rate_nm_per_s=(500.0, 500.0))
    controller = ObservedController(arm, ControlConfig(), slow)
    with pytest.raises(
        TrajectoryError, match=r"the effort of elbow .* within 0\.002 s at 0\.398 s; .* most 1 N·m"
    ):
        controller.start(goal)
    assert not controller.active


def bearing(effort_nm: float, arm: ArmConfig) -> TrialGoal:
    """Return a movement to where the shoulder bears a load."""
    goal = reach()
    share = np.linspace(0.0, 1.0, len(goal.equilibrium_rad))[:, None]
    load_rad = effort_nm / np.array(arm.stiffness_nm_per_rad) * [1.0, 0.0]
    return replace(goal, equilibrium_rad=goal.desired.position_rad + share * load_rad)


def test_an_arm_that_would_sag_too_far_when_it_is_held_is_not_moved(arm: ArmConfig) -> None:
    goal = bearing(3.0, arm)
    controller = ObservedController(arm, ControlConfig(path_tolerance_rad=0.15))
    why = (
        r"shoulder bears 3 N·m at rest: .* would sag by 0\.200 rad; expected at most the path tolerance of "
        r"0\.15 rad\. It needs a gain of 20 N·m/rad instead of 15"
    )
    with pytest.raises(TrajectoryError, match=why):
        controller.start(goal)
    assert not controller.active
    stiffer = replace(arm, stiffness_nm_per_rad=(20.5, 15.0))
    ObservedController(stiffer, ControlConfig(path_tolerance_rad=0.15)).start(bearing(3.0, stiffer))


def test_a_stopped_arm_is_held_with_the_efforts_of_the_last_goal_that_was_reached(arm: ArmConfig) -> None:
    controller, goal = ObservedController(arm, ControlConfig(), SafetyConfig()), reach()
    start, still = goal.desired.position_rad[0], np.zeros(2)
    controller.start(goal)
    for k in range(1, 5):
        assert controller.tick(ArmState(k * PERIOD_NS, start, still)) is not None
    controller.reached_nm = np.array([3.0, -1.5])
    controller.cancel()
    tick = controller.tick(ArmState(5 * PERIOD_NS, start, still))
    assert tick is not None and tick.phase == Phase.STOP
    np.testing.assert_allclose(tick.effort_nm, controller.reached_nm)
    moved = controller.tick(ArmState(6 * PERIOD_NS, start + 0.01, still))
    assert moved is not None
    np.testing.assert_allclose(moved.effort_nm, controller.reached_nm - 0.01 * 15.0)


def test_an_arm_that_cannot_be_trusted_stays_held_by_its_controller_and_that_is_told(arm: ArmConfig) -> None:
    controller, goal = ObservedController(arm, ControlConfig(), SafetyConfig()), reach()
    start, still, k = goal.desired.position_rad[0], np.zeros(2), 0
    controller.start(goal)
    while controller.active and k < 500:
        k += 1
        away = np.array([0.0, 0.001 * 2.0 ** (0.002 * k / 0.12)])
        controller.tick(ArmState(k * PERIOD_NS, start + away, still))
    assert controller.report is not None
    assert "elbow moves away" in controller.report.message
    assert "its controller holds it all the same: switch that off" in controller.report.message
    held = controller.tick(ArmState((k + 1) * PERIOD_NS, start + away, still))
    moved = controller.tick(ArmState((k + 2) * PERIOD_NS, start + away + 0.01, still))
    assert held is not None and moved is not None
    np.testing.assert_allclose(moved.effort_nm - held.effort_nm, -0.01 * 15.0)
    assert not controller.at_final_effort
