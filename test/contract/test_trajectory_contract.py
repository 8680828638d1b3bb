"""What tel_ros expects of a joint_trajectory_controller, on the stand-in and on any other (see conftest.py).

Against a real one, whose arm moves by a few hundredths of a radian: ``pytest test/contract --arm-config RUN``
with ``arm.command_interface: trajectory`` there. The arm has to bear being held by the gains alone.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
import pytest
from action_msgs.msg import GoalStatus
from builtin_interfaces.msg import Time
from control_msgs.action import FollowJointTrajectory
from follower_under_test import FollowerUnderTest
from scipy.interpolate import BPoly
from trajectory_msgs.msg import JointTrajectory

from tel_ros.nodes.conversions import time_ns
from tel_ros.recording import topics

pytestmark = pytest.mark.timeout(90)

Result = FollowJointTrajectory.Result
PUSH = 0.02
VERY_LONG_S = 600.0
"""In lockstep a minute passes while a busy machine makes a test wait."""


def test_it_tells_its_state_reliably_and_has_the_gains_of_the_arm(follower: FollowerUnderTest) -> None:
    topic = f"{follower.name}/{topics.CONTROLLER_STATE}"
    (publisher,) = follower.node.get_publishers_info_by_topic(topic)
    assert publisher.topic_type == "control_msgs/msg/JointTrajectoryControllerState"
    quality = publisher.qos_profile
    assert (quality.reliability.name, quality.durability.name) == ("RELIABLE", "VOLATILE")
    assert follower.parameter("command_interfaces") == ["effort"]
    arm = follower.config.arm
    np.testing.assert_allclose(follower.gains["p"], arm.stiffness_nm_per_rad)
    np.testing.assert_allclose(follower.gains["d"], arm.damping_nms_per_rad)


def test_a_goal_is_followed_along_the_spline_with_its_efforts(follower: FollowerUnderTest) -> None:
    effort_nm = PUSH * np.array(follower.config.arm.effort_limit_nm)
    trajectory = follower.swing(1.0, effort_nm.tolist())
    status, result = follower.follow(follower.goal(trajectory, goal=1.0, path=1.0))
    assert (status, result.error_code) == (GoalStatus.STATUS_SUCCEEDED, Result.SUCCESSFUL)
    assert result.error_string == "Goal successfully reached!"
    told = follower.told()
    times_s = [time_ns(point.time_from_start) / 1e9 for point in trajectory.points]
    rows = [[point.positions, point.velocities, point.accelerations] for point in trajectory.points]
    spline = BPoly.from_derivatives(times_s, np.array(rows))
    while_s = told["since_ns"] / 1e9
    under_way = (while_s > 0.0) & (while_s < 1.0)
    assert np.sum(under_way) > 20
    np.testing.assert_allclose(told["y"][under_way], spline(while_s[under_way]), atol=1e-6)
    np.testing.assert_allclose(told["e"], told["y"] - told["q"], atol=1e-9)
    before_the_end = under_way & (while_s < 0.9)
    law = effort_nm + follower.gains["p"] * told["e"] + follower.gains["d"] * told["de"]
    np.testing.assert_allclose(told["effort"][before_the_end], law[before_the_end], atol=1e-6)


def test_feedback_tells_what_is_wanted_and_what_is(follower: FollowerUnderTest) -> None:
    follower.follow(follower.goal(follower.swing(1.0)))
    assert follower.feedback
    for said in follower.feedback:
        assert set(said.joint_names) == set(follower.joints)
        wanted, measured, error = (np.array(p.positions) for p in (said.desired, said.actual, said.error))
        np.testing.assert_allclose(error, wanted - measured, atol=1e-9)


def test_a_goal_that_is_reached_is_held_with_the_effort_of_its_end(follower: FollowerUnderTest) -> None:
    effort_nm = PUSH * np.array(follower.config.arm.effort_limit_nm)
    follower.follow(follower.goal(follower.swing(0.5, effort_nm.tolist()), goal=1.0))
    follower.spin_until(
        lambda: follower.told()["since_ns"][-1] > 0 and len(follower.states) > 0, 5.0, "a state"
    )
    told = follower.told()
    held = effort_nm + follower.gains["p"] * told["e"][-1] + follower.gains["d"] * told["de"][-1]
    np.testing.assert_allclose(told["effort"][-1], held, atol=1e-6)


def assert_held_by_the_gains(follower: FollowerUnderTest) -> None:
    """Wait for states in which the arm is held where it was, by the gains.

    What 4.42.1 adds are the efforts with which the last goal was reached.
    """

    def is_held() -> bool:
        follower.catch_up()
        told = follower.told()
        if not len(told["stamp_ns"]):
            return False
        law = follower.gains["p"] * told["e"][-1] + follower.gains["d"] * told["de"][-1]
        added = told["effort"][-1] - law
        known = any(np.allclose(added, each, atol=1e-6) for each in (0.0, follower.reached_nm))
        return not told["dy"][-1].any() and known

    follower.spin_until(is_held, 10.0, "a state in which the arm is held")
    told = follower.told()
    lately_rad = told["q"][-200:]
    assert np.all(np.min(np.abs(lately_rad - told["y"][-1]), axis=0) < 1e-6), (
        "it holds where the arm never was"
    )


def test_leaving_the_path_aborts_and_holds_the_arm_where_it_is(follower: FollowerUnderTest) -> None:
    pushed = (-PUSH * np.array(follower.config.arm.effort_limit_nm)).tolist()
    status, result = follower.follow(follower.goal(follower.swing(2.0, pushed), path=1e-4))
    assert (status, result.error_code) == (GoalStatus.STATUS_ABORTED, Result.PATH_TOLERANCE_VIOLATED)
    assert result.error_string == "Aborted due to path tolerance violation"
    assert_held_by_the_gains(follower)


def test_an_end_that_is_not_reached_in_time_aborts(follower: FollowerUnderTest) -> None:
    status, result = follower.follow(follower.goal(follower.swing(0.5), goal=1e-9, time_s=0.2))
    assert (status, result.error_code) == (GoalStatus.STATUS_ABORTED, Result.GOAL_TOLERANCE_VIOLATED)
    over_s = float(
        result.error_string.removeprefix("Aborted due to goal_time_tolerance exceeding by ").split()[0]
    )
    assert 0.2 < over_s < 0.25


def test_a_cancelled_goal_ends_at_once_and_the_arm_is_held(follower: FollowerUnderTest) -> None:
    handle = follower.send(follower.goal(follower.swing(VERY_LONG_S)))
    follower.spin_until(lambda: len(follower.states) > 20, 10.0, "states")
    assert len(follower.wait(handle.cancel_goal_async(), "the answer to a cancellation").goals_canceling) == 1
    status, result = follower.end(handle)
    assert (status, result.error_code, result.error_string) == (GoalStatus.STATUS_CANCELED, 0, "")
    assert_held_by_the_gains(follower)


def test_a_new_goal_takes_the_place_of_the_one_before(follower: FollowerUnderTest) -> None:
    first = follower.send(follower.goal(follower.swing(VERY_LONG_S)))
    follower.spin_until(lambda: len(follower.states) > 20, 10.0, "states")
    second = follower.send(follower.goal(follower.swing(0.5), goal=1.0), at_once=True)
    status, result = follower.end(second)
    assert (status, result.error_code) == (GoalStatus.STATUS_SUCCEEDED, Result.SUCCESSFUL)
    status, result = follower.end(first)
    assert (status, result.error_code) == (GoalStatus.STATUS_ABORTED, Result.INVALID_GOAL)
    assert result.error_string == "Current goal preempted by new incoming action."


def other_joints(trajectory: JointTrajectory) -> None:
    trajectory.joint_names[-1] = "nobody"


def a_joint_less(trajectory: JointTrajectory) -> None:
    trajectory.joint_names.pop()


def no_points(trajectory: JointTrajectory) -> None:
    trajectory.points.clear()


def equal_times(trajectory: JointTrajectory) -> None:
    trajectory.points[2].time_from_start = trajectory.points[1].time_from_start


def in_the_past(trajectory: JointTrajectory) -> None:
    trajectory.header.stamp = Time(nanosec=1)


def moving_at_the_end(trajectory: JointTrajectory) -> None:
    trajectory.points[-1].velocities[0] = 0.1


def velocities_missing(trajectory: JointTrajectory) -> None:
    trajectory.points[1].velocities.pop()


@pytest.mark.parametrize(
    "spoil",
    [other_joints, a_joint_less, no_points, equal_times, in_the_past, moving_at_the_end, velocities_missing],
)
def test_a_goal_that_cannot_be_followed_is_rejected_and_changes_nothing(
    follower: FollowerUnderTest, spoil: Callable[[JointTrajectory], None]
) -> None:
    if spoil is in_the_past:
        # Time has to have passed for an end to be over.
        follower.follow(follower.goal(follower.swing(0.5), goal=1.0))
    trajectory = follower.swing(0.3)
    spoil(trajectory)
    handle = follower.send(follower.goal(trajectory))
    assert not handle.accepted
    begun = time.monotonic()
    follower.spin_until(lambda: time.monotonic() > begun + 0.3, 1.0, "some time")
    # In lockstep time stands still, and nothing is told at all.
    wanted_rad = follower.told()["y"].reshape(-1, len(follower.joints))
    assert not np.any(np.diff(wanted_rad, axis=0))


def test_a_trajectory_without_an_action_is_followed(follower: FollowerUnderTest) -> None:
    follower.states.clear()
    follower.spin_until(lambda: follower.publisher.get_subscription_count() > 0, 10.0, "its subscription")
    follower.publisher.publish(follower.swing(0.5))

    def is_over() -> bool:
        told = follower.told()
        return bool(np.any(told["since_ns"] >= 4e8)) and np.max(told["y"][-200:] - follower.home_rad) > 0.02

    follower.spin_until(is_over, 10.0, "the end of the trajectory")
