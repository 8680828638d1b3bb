"""The plane that the path of a hand is drawn in."""

from __future__ import annotations

import numpy as np
import pytest

from tel_ros.app.plane import drawing_plane


def test_a_plane_of_the_base_frame_is_taken_as_it_is() -> None:
    t = np.linspace(0.0, 6.0, 50)
    plane = drawing_plane(np.column_stack([np.cos(t), 0.7 + 4e-4 * np.sin(t), np.sin(t)]))
    assert plane.names == ("x", "z")
    assert not plane.principal
    np.testing.assert_allclose(plane.project(np.array([[0.1, 0.7, 0.3]])), [[0.1, 0.3]])


def test_a_hand_that_leaves_every_plane_is_drawn_in_that_of_largest_extent() -> None:
    rng = np.random.default_rng(1)
    tilted = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    # A grid in the tilted plane, each place taken once above and once below: symmetric, so the fit is exact.
    along, across = np.meshgrid(np.linspace(-0.5, 0.5, 9), np.linspace(-0.3, 0.3, 7))
    flat = np.column_stack([along.ravel(), across.ravel()]) @ tilted[:2]
    places = np.vstack([flat + 0.004 * tilted[2], flat - 0.004 * tilted[2]]) + [0.2, 0.1, 0.4]
    plane = drawing_plane(places)
    assert plane.principal
    assert plane.out_of_plane_m == pytest.approx(0.004)
    assert "leaves it by up to 4 mm" in plane.description
    np.testing.assert_allclose(np.ptp(plane.project(places), axis=0), [1.0, 0.6])


def test_a_hand_in_a_tilted_plane_is_said_not_to_leave_it() -> None:
    t = np.linspace(0.0, 6.0, 50)
    plane = drawing_plane(np.column_stack([np.cos(t), np.sin(t), np.cos(t) + np.sin(t)]))
    assert plane.principal
    assert "does not leave" in plane.description
