"""Which samples tell of dry friction, and how far those are believed that do not."""

from __future__ import annotations

import numpy as np
import pytest

from tel_ros.core.learning.experience import stuck_trust
from tel_ros.core.learning.noise import SLOWEST_SLIDING_RAD_S, slides_throughout

NO_NOISE = np.zeros(1)


def column(*values: float) -> np.ndarray:
    return np.array(values)[:, None]


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_joint_slides_where_all_its_neighbours_move_the_same_way(sign: float) -> None:
    velocity = sign * column(1.0, 1.0, 1.0, 1.0, -1.0, -1.0, -1.0, -1.0)
    found = slides_throughout(velocity, NO_NOISE, reach=1)
    np.testing.assert_array_equal(found, column(1, 1, 1, 0, 0, 1, 1, 1) > 0)
    found = slides_throughout(velocity, NO_NOISE, reach=3)
    np.testing.assert_array_equal(found, column(1, 0, 0, 0, 0, 0, 0, 1) > 0)


def test_a_joint_that_creeps_may_stick() -> None:
    creeping, sliding = 0.9 * SLOWEST_SLIDING_RAD_S, 1.1 * SLOWEST_SLIDING_RAD_S
    found = slides_throughout(np.tile([creeping, sliding, -sliding], (5, 1)), np.zeros(3), reach=1)
    np.testing.assert_array_equal(found, np.tile([False, True, True], (5, 1)))


def test_movement_has_to_stand_out_of_the_noise() -> None:
    velocity = np.full((5, 2), 0.2)
    found = slides_throughout(velocity, np.array([0.05, 0.1]), reach=1)
    np.testing.assert_array_equal(found, np.tile([True, False], (5, 1)))


def test_each_joint_has_its_own_answer() -> None:
    velocity = np.column_stack([np.ones(6), np.zeros(6)])
    found = slides_throughout(velocity, np.zeros(2), reach=1)
    assert found[:, 0].all() and not found[:, 1].any()


def test_trust_is_the_ratio_of_the_variances_of_sliding_and_sticking() -> None:
    """A torque that may be anything within ±c has the variance c² / 3."""
    sliding = np.array([[True], [True], [False], [False]])
    residual = column(0.01, -0.01, 5.0, 7.0)
    (found,) = stuck_trust(residual, sliding, np.array([0.3]))
    assert found == pytest.approx(1e-4 / (1e-4 + 0.03))


def test_without_dry_friction_every_sample_is_believed() -> None:
    sliding = np.array([[True], [False]])
    np.testing.assert_array_equal(stuck_trust(column(0.01, 5.0), sliding, np.zeros(1)), 1.0)
    np.testing.assert_array_equal(stuck_trust(column(0.0, 5.0), sliding, np.zeros(1)), 1.0)


def test_a_joint_that_never_slides_is_believed_because_there_is_nothing_else() -> None:
    sliding = np.zeros((3, 1), dtype=bool)
    np.testing.assert_array_equal(stuck_trust(column(1.0, 2.0, 3.0), sliding, np.array([0.3])), 1.0)


def test_trust_never_becomes_nothing() -> None:
    sliding = np.array([[True], [False]])
    (found,) = stuck_trust(column(0.0, 5.0), sliding, np.array([0.3]))
    assert 0.0 < found < 1e-9
