"""The springs of a trial in the message that carries its goal."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tel_ros.core.errors import TrajectoryError
from tel_ros.core.springs import Springs
from tel_ros.core.trajectories.paths import NAMED_PATHS
from tel_ros.core.trajectories.trajectory import sample
from tel_ros.core.trial import TrialGoal
from tel_ros.nodes.conversions import to_goal, to_goal_message

JOINTS = ("shoulder", "elbow")
DESIRED = sample(NAMED_PATHS["planar_loops"], 1.0, 100.0)
GOAL = TrialGoal(3, 0.5, DESIRED, DESIRED.position_rad)
SPRINGS = Springs(np.array([30.0, 45.0]), np.array([2.0, 3.0]))


def test_springs_come_back_in_the_order_of_the_joints() -> None:
    message = to_goal_message(replace(GOAL, springs=SPRINGS), JOINTS)
    for joints, order in ((JOINTS, [0, 1]), (JOINTS[::-1], [1, 0])):
        springs = to_goal(message, joints).springs
        assert springs is not None
        np.testing.assert_array_equal(springs.stiffness_nm_per_rad, SPRINGS.stiffness_nm_per_rad[order])
        np.testing.assert_array_equal(springs.damping_nms_per_rad, SPRINGS.damping_nms_per_rad[order])


def test_a_goal_that_says_nothing_of_springs_has_the_configured_ones() -> None:
    assert to_goal(to_goal_message(GOAL, JOINTS), JOINTS).springs is None


@pytest.mark.parametrize(
    ("stiffness", "damping", "expected"),
    [
        ([30.0, 45.0], [], "damping_nms_per_rad has 0 values; expected 2"),
        ([], [2.0, 3.0], "stiffness_nm_per_rad has 0 values; expected 2"),
        ([30.0, 45.0, 60.0], [2.0, 3.0], "stiffness_nm_per_rad has 3 values; expected 2"),
        ([30.0, float("nan")], [2.0, 3.0], "expected finite numbers, stiffness above 0"),
        ([30.0, 45.0], [2.0, -3.0], "damping of at least 0"),
    ],
)
def test_springs_that_do_not_fit_are_refused(
    stiffness: list[float], damping: list[float], expected: str
) -> None:
    message = to_goal_message(GOAL, JOINTS)
    message.stiffness_nm_per_rad, message.damping_nms_per_rad = stiffness, damping
    with pytest.raises(TrajectoryError, match=expected):
        to_goal(message, JOINTS)
