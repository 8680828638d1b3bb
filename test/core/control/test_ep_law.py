"""The control law τ = K (u - q) - B q̇."""

from __future__ import annotations

import numpy as np
import pytest

from tel_ros.core.control.ep_law import EpLaw

LAW = EpLaw(np.array([15.0, 10.0]), np.array([1.5, 0.5]), np.array([20.0, 8.0]))


def test_the_effort_is_that_of_a_spring_and_a_damper_at_each_joint() -> None:
    effort, saturated = LAW.effort(np.array([1.0, 0.2]), np.array([0.4, 0.5]), np.array([2.0, -1.0]))
    np.testing.assert_allclose(effort, [15.0 * 0.6 - 1.5 * 2.0, 10.0 * -0.3 + 0.5 * 1.0], atol=1e-14)
    assert saturated.tolist() == [False, False]


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_only_the_joint_that_asks_for_too_much_is_clipped_and_says_so(sign: float) -> None:
    effort, saturated = LAW.effort(sign * np.array([0.5, 0.9]), np.zeros(2), np.zeros(2))
    np.testing.assert_allclose(effort, sign * np.array([7.5, 8.0]), atol=1e-14)
    assert saturated.tolist() == [False, True]


def test_an_effort_exactly_at_the_limit_is_not_clipped() -> None:
    effort, saturated = LAW.effort(np.array([0.0, 0.75]), np.zeros(2), np.array([0.0, -1.0]))
    assert effort.tolist() == [0.0, 8.0]
    assert saturated.tolist() == [False, False]


def test_the_damper_counts_against_the_limit_too() -> None:
    effort, saturated = LAW.effort(np.zeros(2), np.zeros(2), np.array([100.0, 0.0]))
    assert effort.tolist() == [-20.0, 0.0]
    assert saturated.tolist() == [True, False]
