"""What the network sees."""

from __future__ import annotations

import numpy as np
import pytest
from two_link import loops

from tel_ros.core.learning.inputs import InputRange, query_inputs, stack_inputs
from tel_ros.core.trajectories.trajectory import DesiredTrajectory

RANGE = InputRange(low=np.array([-1.0, 10.0]), high=np.array([1.0, 20.0]))


def test_inputs_are_positions_then_velocities_then_accelerations() -> None:
    q, v, a = np.arange(18.0).reshape(3, 3, 2)
    assert stack_inputs(q, v, a)[1].tolist() == [*q[1], *v[1], *a[1]]


def test_a_range_is_mapped_to_the_unit_interval() -> None:
    scaled = RANGE.scale(np.array([[-1.0, 10.0], [0.0, 12.5], [1.0, 20.0]]))
    np.testing.assert_allclose(scaled, [[0.0, 0.0], [0.5, 0.25], [1.0, 1.0]], atol=1e-15)


def test_values_outside_the_range_are_taken_for_its_end() -> None:
    np.testing.assert_array_equal(RANGE.scale(np.array([[-1e9, 21.0], [3.0, -np.inf]])), [[0, 1], [1, 0]])


def test_the_range_covers_the_goal_movement_with_the_margin() -> None:
    desired = loops(4.5).desired
    inputs = query_inputs(desired, 0.002)
    exact, wide = InputRange.covering(desired, 1.0), InputRange.covering(desired, 1.5)
    for covering in (exact, wide):
        assert np.all(covering.low - 1e-12 <= inputs)  # rounding
        assert np.all(inputs <= covering.high + 1e-12)
    q = desired.position_rad
    np.testing.assert_allclose(exact.low[:2], q.min(axis=0), atol=1e-12)
    np.testing.assert_allclose((wide.high - wide.low)[:2], 1.5 * np.ptp(q, axis=0), rtol=1e-12)
    np.testing.assert_allclose((wide.high + wide.low)[:2], q.min(axis=0) + q.max(axis=0), rtol=1e-12)
    np.testing.assert_allclose(wide.high[2:], 1.5 * exact.high[2:], rtol=1e-12)


def test_velocities_and_accelerations_may_go_either_way() -> None:
    covering = InputRange.covering(loops(4.5).desired, 1.3)
    np.testing.assert_array_equal(covering.low[2:], -covering.high[2:])
    np.testing.assert_allclose(
        covering.high[2:4], 1.3 * np.abs(loops(4.5).desired.velocity_rad_s).max(axis=0)
    )


def test_a_joint_that_the_movement_leaves_alone_still_gets_a_range() -> None:
    still = DesiredTrajectory(np.array([0, 10]), np.full((2, 1), 0.7), np.zeros((2, 1)), np.zeros((2, 1)))
    covering = InputRange.covering(still, 1.3)
    np.testing.assert_allclose(covering.low, [-0.3, -1.0, -1.0])
    np.testing.assert_allclose(covering.high, [1.7, 1.0, 1.0])


def test_a_command_is_asked_for_at_the_acceleration_in_the_middle_of_its_interval() -> None:
    desired = loops(3.0).desired
    inputs = query_inputs(desired, 0.002)
    np.testing.assert_array_equal(inputs[:, :2], desired.position_rad)
    np.testing.assert_array_equal(inputs[:, 2:4], desired.velocity_rad_s)
    acceleration = desired.acceleration_rad_s2
    np.testing.assert_allclose(inputs[:-1, 4:], 0.5 * (acceleration[:-1] + acceleration[1:]), atol=1e-9)
    np.testing.assert_array_equal(inputs[-1, 4:], acceleration[-1])


@pytest.mark.parametrize("period_s", [0.002, 0.01, 0.05])
def test_the_middle_is_half_a_control_period_ahead_however_far_apart_the_points_are(period_s: float) -> None:
    time_ns = np.arange(11) * 100_000_000
    ramp = np.arange(11.0)[:, None]  # 10 rad/s³
    desired = DesiredTrajectory(time_ns, np.zeros((11, 1)), np.zeros((11, 1)), ramp)
    inputs = query_inputs(desired, period_s)
    np.testing.assert_allclose(inputs[:-1, 2], ramp[:-1, 0] + 10.0 * period_s / 2, atol=1e-12)
