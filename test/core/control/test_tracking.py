"""What a goal may ask for, what a moving arm may not do, and the score of a trial."""

from __future__ import annotations

import numpy as np
import pytest
from two_link import arm_config, reach

from tel_ros.core.arm_state import ArmState
from tel_ros.core.control.tracking import Limits, TrackingScore
from tel_ros.core.errors import TrajectoryError
from tel_ros.core.trajectories.trajectory import DesiredTrajectory
from tel_ros.core.trial import Phase, Tick, TrialGoal

LIMITS = Limits.of(
    arm_config(position_min_rad=(-1.0, 0.0), position_max_rad=(1.5, 2.0), velocity_limit_rad_s=(2.0, 3.0)),
    path_tolerance_rad=0.4,
)


def state(position: tuple[float, float] = (0.5, 1.0), velocity: tuple[float, float] = (0.0, 0.0)) -> ArmState:
    return ArmState(0, np.array(position), np.array(velocity))


def violation(desired: tuple[float, float] = (0.5, 1.0), **values: tuple[float, float]) -> str | None:
    return LIMITS.violation(state(**values), np.array(desired))


def goal_with(name: str, row: int, values: tuple[float, float]) -> TrialGoal:
    arrays = {
        "position_rad": np.tile([0.5, 1.0], (4, 1)),
        "velocity_rad_s": np.zeros((4, 2)),
        "acceleration_rad_s2": np.zeros((4, 2)),
    }
    arrays[name][row] = values
    desired = DesiredTrajectory(time_ns=np.arange(4) * 100_000_000, **arrays)
    return TrialGoal(1, 1.0, desired, desired.position_rad)


def test_a_goal_within_the_limits_is_let_through() -> None:
    LIMITS.check_goal(reach((0.6, 1.3), (0.9, 1.0)), 0.05)


def test_a_goal_that_touches_the_limits_is_let_through() -> None:
    LIMITS.check_goal(goal_with("position_rad", 2, (1.5, 0.0)), 0.05)
    LIMITS.check_goal(goal_with("velocity_rad_s", 2, (-2.0, 3.0)), 0.05)


@pytest.mark.parametrize(
    ("name", "values", "message"),
    [
        (
            "position_rad",
            (1.501, 1.0),
            "shoulder should be at 1.501 rad at 0.200 s; expected -1.000 to 1.500 rad",
        ),
        (
            "position_rad",
            (0.5, -0.01),
            "elbow should be at -0.010 rad at 0.200 s; expected 0.000 to 2.000 rad",
        ),
        (
            "velocity_rad_s",
            (-2.1, 0),
            "shoulder should be at -2.100 rad/s at 0.200 s; expected -2.000 to 2.000 rad/s",
        ),
        (
            "velocity_rad_s",
            (0, 3.1),
            "elbow should be at 3.100 rad/s at 0.200 s; expected -3.000 to 3.000 rad/s",
        ),
    ],
)
def test_a_goal_outside_the_limits_is_refused_with_joint_value_time_and_range(
    name: str, values: tuple[float, float], message: str
) -> None:
    with pytest.raises(TrajectoryError) as refusal:
        LIMITS.check_goal(goal_with(name, 2, values), 0.05)
    assert str(refusal.value) == message


@pytest.mark.parametrize("row", [0, -1], ids=["start", "end"])
def test_a_goal_that_does_not_start_and_end_at_rest_is_refused(row: int) -> None:
    LIMITS.check_goal(goal_with("velocity_rad_s", row, (0.0, -0.05)), 0.05)
    with pytest.raises(
        TrajectoryError, match=r"starts or ends with 0.060 rad/s; expected rest \(up to 0.05 rad/s\)"
    ):
        LIMITS.check_goal(goal_with("velocity_rad_s", row, (0.0, -0.06)), 0.05)


def test_a_goal_for_another_number_of_joints_is_refused() -> None:
    desired = DesiredTrajectory(np.array([0, 10]), *(np.zeros((2, 3)) for _ in range(3)))
    with pytest.raises(TrajectoryError, match="the goal has 3 joints; expected 2"):
        LIMITS.check_goal(TrialGoal(1, 1.0, desired, desired.position_rad), 0.05)


def test_a_state_inside_all_limits_is_no_violation() -> None:
    assert violation() is None
    assert violation(position=(0.89, 1.39), velocity=(-2.0, 3.0)) is None
    assert violation(position=(1.5, 0.0), desired=(1.3, 0.2)) is None


def test_leaving_the_path_tolerance_is_a_violation_with_the_joint_that_is_furthest_off() -> None:
    assert violation(position=(0.95, 0.5)) == (
        "elbow is 0.500 rad off its desired position (path tolerance 0.400 rad)"
    )


def test_too_fast_a_joint_is_a_violation() -> None:
    assert violation(velocity=(-2.5, 2.9)) == "shoulder moves at -2.50 rad/s (limit 2.00 rad/s)"


@pytest.mark.parametrize(
    ("position", "message"),
    [
        ((1.6, 1.0), "shoulder is at 1.600 rad (limits -1.000 to 1.500 rad)"),
        ((-1.1, 1.0), "shoulder is at -1.100 rad (limits -1.000 to 1.500 rad)"),
        ((0.5, -0.1), "elbow is at -0.100 rad (limits 0.000 to 2.000 rad)"),
    ],
)
def test_a_joint_beyond_its_range_is_a_violation(position: tuple[float, float], message: str) -> None:
    assert violation(position=position, desired=position) == message


def test_the_score_is_that_of_all_ticks_together() -> None:
    rng = np.random.default_rng(1)
    errors, efforts = rng.normal(size=(50, 3)), rng.normal(size=(50, 3))
    saturated = rng.random((50, 3)) < 0.1
    score = TrackingScore(3)
    zero = np.zeros(3)
    for error, effort, clipped in zip(errors, efforts, saturated, strict=True):
        score.add(ArmState(0, error, zero), Tick(Phase.RUN, 0.0, zero, zero, zero, zero, effort, clipped))
    assert score.ticks == 50
    found = score.figures()
    # Sums in another order: rounding.
    np.testing.assert_allclose(found["rms_error_rad"], np.sqrt(np.mean(errors**2)), rtol=1e-12)
    per_joint_rad = np.sqrt(np.mean(errors**2, axis=0))
    np.testing.assert_allclose(found["rms_error_per_joint_rad"], per_joint_rad, rtol=1e-12)
    assert found["max_error_rad"] == score.max_error_rad == np.abs(errors).max()
    np.testing.assert_array_equal(found["max_effort_nm"], np.abs(efforts).max(axis=0))
    assert found["saturated_ratio"] == np.mean(saturated.any(axis=1))


def test_without_a_tick_there_is_no_error_to_speak_of() -> None:
    found = TrackingScore(2).figures()
    assert not found.pop("max_effort_nm").any()
    assert all(np.isnan(value).all() for value in found.values())
