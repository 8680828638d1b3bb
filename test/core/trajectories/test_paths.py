"""Paths: the built-in figure and splines through waypoints."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from tel_ros.core.errors import ConfigError
from tel_ros.core.trajectories.paths import (
    NAMED_PATHS,
    Path,
    blended,
    named_path,
    part,
    scaled,
    waypoint_path,
)

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


LOOPS = NAMED_PATHS["planar_loops"]
LINE = waypoint_path("line", np.array([[0.0, 0.5], [1.0, 1.5]]))
S = np.linspace(0.0, 1.0, 2001)

VARIANTS: list[tuple[str, Callable[[], Path]]] = [
    ("scaled", lambda: scaled(LOOPS, 0.3)),
    ("blended", lambda: blended(LINE, LOOPS, 0.4)),
    ("part", lambda: part(LOOPS, 0.25, 0.6)),
    ("part of scaled blend", lambda: part(scaled(blended(LINE, LOOPS, 0.4), 0.7), 0.1, 0.9)),
]


@pytest.mark.parametrize("make", [make for _, make in VARIANTS], ids=[name for name, _ in VARIANTS])
def test_the_derivatives_are_those_of_the_positions(make: Callable[[], Path]) -> None:
    q, dq, ddq = make().evaluate(S)
    inner = slice(1, -1)
    h = S[1]
    # Central differences are right to h²/6 of the third derivative, at most about 5000 rad here.
    np.testing.assert_allclose((q[2:] - q[:-2]) / (2 * h), dq[inner], atol=5000 * h**2)
    np.testing.assert_allclose((dq[2:] - dq[:-2]) / (2 * h), ddq[inner], atol=100_000 * h**2)


def test_a_smaller_path_starts_at_the_same_posture_and_keeps_its_shape() -> None:
    q, whole = scaled(LOOPS, 0.3).evaluate(S)[0], LOOPS.evaluate(S)[0]
    np.testing.assert_array_equal(q[0], whole[0])
    np.testing.assert_allclose(q - q[0], 0.3 * (whole - whole[0]), atol=1e-12)


def test_a_smaller_path_is_drawn_to_its_first_posture_wherever_it_is_asked() -> None:
    q = scaled(LINE, 0.5).evaluate(np.array([1.0]))[0]
    np.testing.assert_allclose(q, [[0.5, 1.0]], atol=1e-12)


@pytest.mark.parametrize(("share", "expected"), [(0.0, LINE), (1.0, LOOPS)])
def test_a_blend_goes_from_the_known_path_to_the_other(share: float, expected: Path) -> None:
    for found, wanted in zip(blended(LINE, LOOPS, share).evaluate(S), expected.evaluate(S), strict=True):
        np.testing.assert_allclose(found, wanted, atol=1e-12)


def test_halfway_a_blend_is_the_mean_of_both_at_each_moment() -> None:
    found = blended(LINE, LOOPS, 0.5).evaluate(S)[0]
    np.testing.assert_allclose(found, 0.5 * (LINE.evaluate(S)[0] + LOOPS.evaluate(S)[0]), atol=1e-12)


def test_parts_put_together_are_the_whole() -> None:
    s = np.linspace(0.0, 1.0, 101)
    parts = [part(LOOPS, k / 4, (k + 1) / 4).evaluate(s)[0] for k in range(4)]
    for before, after in zip(parts, parts[1:], strict=False):
        np.testing.assert_allclose(before[-1], after[0], atol=1e-12)
    whole = LOOPS.evaluate(np.linspace(0.0, 1.0, 401))[0]
    joined = np.vstack([parts[0], *(q[1:] for q in parts[1:])])
    np.testing.assert_allclose(joined, whole, atol=1e-12)
