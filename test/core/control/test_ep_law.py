"""The control law τ = K (u - q) - B q̇."""

from __future__ import annotations

import numpy as np

from tel_ros.core.control.ep_law import EpLaw

LAW = EpLaw(np.array([15.0, 10.0]), np.array([1.5, 0.5]))


def test_the_effort_is_that_of_a_spring_and_a_damper_at_each_joint() -> None:
    effort = LAW.effort(np.array([1.0, 0.2]), np.array([0.4, 0.5]), np.array([2.0, -1.0]))
    np.testing.assert_allclose(effort, [15.0 * 0.6 - 1.5 * 2.0, 10.0 * -0.3 + 0.5 * 1.0], atol=1e-14)


def test_limiting_the_effort_is_left_to_the_safety_layer() -> None:
    assert LAW.effort(np.array([100.0, 0.0]), np.zeros(2), np.zeros(2)).tolist() == [1500.0, 0.0]
