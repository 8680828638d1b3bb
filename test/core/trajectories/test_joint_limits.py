"""Limits for planners: whatever joints do within them, efforts stay within theirs."""

from __future__ import annotations

import numpy as np
import pytest

from tel_ros.core.errors import TrajectoryError
from tel_ros.core.trajectories.joint_limits import joint_limits
from tel_ros.core.types import FloatArray

LIMIT_NM = np.array([20.0, 15.0])


def two_links(inputs: FloatArray) -> FloatArray:
    """A pendulum of two links with gravity, viscous and dry friction (textbook form, distributed masses)."""
    q1, q2, v1, v2, a1, a2 = inputs.T
    c2, s2, gravity = np.cos(q2), np.sin(q2), 4.0
    coupling = 0.3 + 0.4 * c2
    first = (1.5 + 0.8 * c2) * a1 + coupling * a2 - 0.4 * s2 * (2.0 * v1 * v2 + v2**2)
    second = coupling * a1 + 0.3 * a2 + 0.4 * s2 * v1**2
    load = np.column_stack([gravity * np.cos(q1) + np.cos(q1 + q2), np.cos(q1 + q2)])
    v = np.column_stack([v1, v2])
    return np.column_stack([first, second]) + load + 0.5 * v + 0.4 * np.tanh(v / 0.01)


POSTURES = np.random.default_rng(1).uniform(-1.5, 1.5, (40, 2))
SPEED, ACCELERATION = np.array([6.0, 8.0]), np.array([40.0, 60.0])


def test_no_movement_within_the_limits_needs_more_effort_than_it_may() -> None:
    velocity, acceleration = joint_limits(two_links, POSTURES, SPEED, ACCELERATION, LIMIT_NM)
    random = np.random.default_rng(2)
    signs = random.choice([-1.0, 1.0], (20000, 4)) * random.choice([1.0, 0.999, 0.5], (20000, 4))
    states = np.hstack(
        [POSTURES[random.integers(len(POSTURES), size=20000)], signs * [*velocity, *acceleration]]
    )
    share = np.abs(two_links(states)) / LIMIT_NM
    assert share.max() <= 1.0
    # And they are not needlessly low: two or three times the sum of bounds is what boxes cost.
    assert share.max() > 0.8


def test_they_are_those_of_the_movement_at_another_speed() -> None:
    velocity, acceleration = joint_limits(two_links, POSTURES, SPEED, ACCELERATION, LIMIT_NM)
    factor = velocity / SPEED
    np.testing.assert_allclose(factor, factor[0])
    np.testing.assert_allclose(acceleration / ACCELERATION, factor**2)
    assert 0.0 < factor[0] < 1.0


def test_a_slow_movement_keeps_its_own() -> None:
    velocity, acceleration = joint_limits(two_links, POSTURES, 0.01 * SPEED, 1e-4 * ACCELERATION, LIMIT_NM)
    np.testing.assert_allclose(velocity, 0.01 * SPEED)
    np.testing.assert_allclose(acceleration, 1e-4 * ACCELERATION)


def test_an_arm_that_cannot_hold_itself_has_none() -> None:
    with pytest.raises(TrajectoryError, match=r"gravity and friction may take .* N·m of joint 1"):
        joint_limits(two_links, POSTURES, SPEED, ACCELERATION, np.array([3.0, 15.0]))
