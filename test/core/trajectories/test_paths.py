"""Paths: the built-in figure and splines through waypoints."""

from __future__ import annotations

import numpy as np
import pytest

from tel_ros.core.errors import ConfigError
from tel_ros.core.trajectories.paths import NAMED_PATHS, Path, named_path, waypoint_path

OPEN = np.array([[0.0, 0.5], [0.4, 0.9], [0.5, 0.2], [1.2, 0.0]])
CLOSED = np.vstack([OPEN, OPEN[:1]])


def knots(waypoints_rad: np.ndarray) -> np.ndarray:
    """Return where on the path the waypoints should be: share of the way along straight lines."""
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(waypoints_rad, axis=0), axis=1))])
    return way / way[-1]


def test_planar_loops_is_the_figure_in_its_description() -> None:
    s = np.linspace(0.0, 1.0, 401)
    q, _, _ = NAMED_PATHS["planar_loops"].evaluate(s)
    shoulder = 0.6 + 0.45 * np.sin(4 * np.pi * s) + 0.2 * np.sin(6 * np.pi * s)
    elbow = 1.3 + 0.5 * np.sin(6 * np.pi * s) + 0.25 * (np.cos(4 * np.pi * s) - 1)
    np.testing.assert_allclose(q, np.column_stack([shoulder, elbow]), atol=1e-14)  # rounding only


@pytest.mark.parametrize("path", NAMED_PATHS.values(), ids=lambda path: path.name)
def test_built_in_paths_end_where_they_began(path: Path) -> None:
    for derivative in path.evaluate(np.array([0.0, 1.0])):
        # A sine of 6π as a float is 7e-16, times 0.5 (6π)² = 178.
        np.testing.assert_allclose(derivative[0], derivative[1], atol=1e-12)


@pytest.mark.parametrize(
    "path",
    [*NAMED_PATHS.values(), waypoint_path("open", OPEN), waypoint_path("closed", CLOSED)],
    ids=lambda path: path.name,
)
def test_derivatives_of_a_path_are_those_of_its_positions(path: Path) -> None:
    h = 1e-5
    s = np.linspace(0.013, 0.987, 300)
    _, dq, ddq = path.evaluate(s)
    (above, dq_above, _), (below, dq_below, _) = path.evaluate(s + h), path.evaluate(s - h)
    # Truncation h² q''' / 6 with q''' < 1e4, plus rounding 1e-16 / h; where a spline's third derivative jumps
    # between s - h and s + h the second is off by h q''' / 2 < 0.05.
    np.testing.assert_allclose(dq, (above - below) / (2 * h), atol=1e-6)
    np.testing.assert_allclose(ddq, (dq_above - dq_below) / (2 * h), atol=0.05)


@pytest.mark.parametrize("waypoints_rad", [OPEN, CLOSED, OPEN[:2]], ids=["open", "closed", "two"])
def test_a_waypoint_path_goes_through_its_waypoints_in_order(waypoints_rad: np.ndarray) -> None:
    q, _, _ = waypoint_path("p", waypoints_rad).evaluate(knots(waypoints_rad))
    np.testing.assert_allclose(q, waypoints_rad, atol=1e-12)  # rounding of the spline's coefficients


def test_a_path_of_two_waypoints_is_straight() -> None:
    q, dq, ddq = waypoint_path("p", OPEN[:2]).evaluate(np.array([0.25, 0.5]))
    np.testing.assert_allclose(q, [[0.1, 0.6], [0.2, 0.7]], atol=1e-12)
    np.testing.assert_allclose(dq, [[0.4, 0.4]] * 2, atol=1e-12)
    np.testing.assert_allclose(ddq, 0.0, atol=1e-9)


def test_a_closed_waypoint_path_closes_without_a_corner() -> None:
    q, dq, ddq = waypoint_path("p", CLOSED).evaluate(np.array([0.0, 1.0]))
    for values in (q, dq, ddq):
        np.testing.assert_allclose(values[0], values[1], atol=1e-9)  # of derivatives of order 100
    assert np.linalg.norm(dq[0]) > 0.1


def test_an_open_waypoint_path_is_not_bent_at_its_ends() -> None:
    _, _, ddq = waypoint_path("p", OPEN).evaluate(np.array([0.0, 1.0]))
    np.testing.assert_allclose(ddq, 0.0, atol=1e-9)


def test_an_unknown_path_is_refused_with_the_names_that_there_are() -> None:
    with pytest.raises(ConfigError, match=r"^path.name is 'planar_loop'; expected one of .*planar_loops"):
        named_path("planar_loop", 2)


def test_a_built_in_path_for_another_number_of_joints_is_refused() -> None:
    with pytest.raises(
        ConfigError, match=r"path.name is 'planar_loops'; expected a path for 3 joints .* for 2"
    ):
        named_path("planar_loops", 3)


@pytest.mark.parametrize("name", ["kuka_iiwa_loops", "franka_panda_loops"])
def test_all_seven_joints_take_part_about_half_a_radian_to_either_side(name: str) -> None:
    q, _, _ = named_path(name, 7).evaluate(np.linspace(0.0, 1.0, 401))
    half_width = 0.5 * (q.max(axis=0) - q.min(axis=0))
    assert np.all((half_width > 0.4) & (half_width < 0.6))
    in_step = np.abs(np.corrcoef(q.T)) - np.eye(7)
    assert in_step.max() < 0.95, "joints in step with each other show a learner only one of them"
