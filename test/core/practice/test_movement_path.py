"""From a movement that a strategy asks for to a trajectory and a command."""

from __future__ import annotations

import numpy as np
import pytest
from two_link import arm_config

from tel_ros.core.errors import ConfigError
from tel_ros.core.practice.movement_path import (
    command,
    desired_trajectory,
    forecast_of,
    forecast_trajectory,
    movement_path,
)
from tel_ros.core.practice.strategy import Movement
from tel_ros.core.springs import Springs
from tel_ros.core.trajectories.paths import NAMED_PATHS, waypoint_path
from tel_ros.core.trajectories.trajectory import sample

LOOPS = NAMED_PATHS["planar_loops"]
LINE = waypoint_path("line", np.array([[0.2, 0.5], [1.0, 1.5]]))
ENDS = np.array([0.0, 1.0])
CONFIGURED = Springs.of(arm_config())


def test_a_movement_that_varies_only_the_speed_has_the_path_itself() -> None:
    assert movement_path(LOOPS, None, Movement(3.0)) is LOOPS
    assert movement_path(LOOPS, LINE, Movement(3.0, stiffness=2.0)) is LOOPS


def test_the_blend_is_drawn_together_about_its_own_first_posture() -> None:
    blend = movement_path(LOOPS, LINE, Movement(3.0, shape=0.5)).evaluate(ENDS)[0]
    small = movement_path(LOOPS, LINE, Movement(3.0, shape=0.5, amplitude=0.1)).evaluate(ENDS)[0]
    np.testing.assert_allclose(small[0], blend[0])
    np.testing.assert_allclose(small[1] - small[0], 0.1 * (blend[1] - blend[0]))


def test_without_a_known_path_the_shape_cannot_vary() -> None:
    with pytest.raises(ConfigError, match="path.known_name is ''; expected a known path"):
        movement_path(LOOPS, None, Movement(3.0, shape=0.5))


def test_a_part_takes_its_share_of_the_time_and_starts_and_ends_at_rest() -> None:
    movement = Movement(8.0, start=0.25, end=0.5)
    desired = desired_trajectory(LOOPS, None, movement, 500.0)
    assert desired.duration_s == 2.0
    np.testing.assert_allclose(desired.velocity_rad_s[[0, -1]], 0.0, atol=1e-12)
    np.testing.assert_allclose(desired.position_rad[[0, -1]], LOOPS.evaluate(np.array([0.25, 0.5]))[0])
    assert np.abs(desired.velocity_rad_s).max() > 0.5, "it moves between them"


def test_the_whole_is_sampled_as_ever() -> None:
    found, expected = desired_trajectory(LOOPS, None, Movement(4.5), 500.0), sample(LOOPS, 4.5, 500.0)
    np.testing.assert_array_equal(found.position_rad, expected.position_rad)
    np.testing.assert_array_equal(found.acceleration_rad_s2, expected.acceleration_rad_s2)


def test_as_stiff_as_configured_the_command_is_the_prediction_itself() -> None:
    desired = sample(LOOPS, 4.5, 500.0)
    springs, equilibrium_rad = command(CONFIGURED, Movement(4.5), desired, desired.position_rad)
    assert springs is None
    assert equilibrium_rad is desired.position_rad


def test_stiffer_springs_are_sent_to_where_they_exert_the_predicted_effort() -> None:
    arm, desired = arm_config(), sample(LOOPS, 4.5, 500.0)
    predicted = desired.position_rad + 0.1
    springs, equilibrium_rad = command(CONFIGURED, Movement(4.5, stiffness=4.0), desired, predicted)
    assert springs is not None
    k, b = np.array(arm.stiffness_nm_per_rad), np.array(arm.damping_nms_per_rad)
    np.testing.assert_allclose(springs.stiffness_nm_per_rad, 4.0 * k)
    np.testing.assert_allclose(springs.damping_nms_per_rad, 2.0 * b, err_msg="the damping ratio stays")
    wanted_nm = k * 0.1 - b * desired.velocity_rad_s
    found_nm = 4.0 * k * (equilibrium_rad - desired.position_rad) - 2.0 * b * desired.velocity_rad_s
    np.testing.assert_allclose(found_nm, wanted_nm, atol=1e-12)


def test_of_stiffer_springs_the_forecast_expects_less_deviation_and_the_same_effort() -> None:
    soft, stiff = Movement(4.5), Movement(4.5, stiffness=4.0)
    desired = forecast_trajectory(LOOPS, None, soft)
    offset, std = np.full_like(desired.position_rad, 0.1), np.full_like(desired.position_rad, 0.02)
    of_soft, of_stiff = (
        forecast_of(desired, offset, std, CONFIGURED, movement) for movement in (soft, stiff)
    )
    np.testing.assert_array_equal(of_soft.std_rad, std)
    np.testing.assert_allclose(of_stiff.std_rad, std / 4.0)
    np.testing.assert_array_equal(of_stiff.effort_nm, of_soft.effort_nm)


def test_springs_go_back_to_the_configured_ones_without_a_trace() -> None:
    used = CONFIGURED.scaled(3.0)
    rng = np.random.default_rng(3)
    u, q, v = rng.normal(size=(3, 50, 2))
    there = used.equilibrium_for(CONFIGURED, u, q, v)
    np.testing.assert_allclose(CONFIGURED.equilibrium_for(used, there, q, v), u, atol=1e-12)
