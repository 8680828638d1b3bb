"""Paths on the way to the one that is wanted."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from tel_ros.core.trajectories.paths import NAMED_PATHS, Path, waypoint_path
from tel_ros.core.trajectories.variants import blended, part, scaled

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
