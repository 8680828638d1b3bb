"""Joints that come too fast to a limit are braked in time, and others are left alone."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from two_link import TwoLinkArm, arm_config

from tel_ros.core.arm_state import ArmState
from tel_ros.core.config import SafetyConfig
from tel_ros.core.safety.layer import SafetyLayer
from tel_ros.core.safety.motion_rules import BrakingDistance, SoftLimits
from tel_ros.core.safety.rules import EffortRange, LastEffort

ARM = arm_config()
SOFT_RAD = 2.8
LIMITS = SoftLimits.of(ARM, SafetyConfig())
RULE = dataclasses.replace(
    BrakingDistance.of(ARM, SafetyConfig(), LIMITS),
    deceleration_rad_s2=np.full(2, 20.0),
    creep_rad_s=np.full(2, 1.0),
)
"""Within 1 rad of a limit 1 + √40 = 7.32 rad/s can be braked."""


def permitted(rule: BrakingDistance, position: np.ndarray, velocity: np.ndarray) -> EffortRange:
    return rule.permitted(ArmState(0, position, velocity), LastEffort(np.zeros(2), 0.002))


def highest(room_rad: float, speed_rad_s: float) -> float:
    position, velocity = np.array([SOFT_RAD - room_rad, 0.0]), np.array([speed_rad_s, 0.0])
    up, down = (
        np.broadcast_arrays(bounds.low_nm, bounds.high_nm, np.zeros(2))
        for bounds in (permitted(RULE, position, velocity), permitted(RULE, -position, -velocity))
    )
    assert down[0][0] == -up[1][0]  # the same on both sides
    assert up[0][0] == up[0][1] == -np.inf and up[1][1] == np.inf  # and nothing else is bounded
    return float(up[1][0])


def test_up_to_the_speed_that_can_be_braked_the_effort_is_free() -> None:
    assert highest(1.0, 7.3) == np.inf
    assert highest(1.0, -14.0) == np.inf
    assert highest(-0.5, 0.9) == np.inf


def test_above_it_less_and_less_effort_is_left_and_then_all_of_it_brakes() -> None:
    assert highest(1.0, 7.33) == pytest.approx(20.0, abs=0.5)
    assert highest(1.0, 7.6) < highest(1.0, 7.5) < 20.0
    assert highest(1.0, 7.32 + 20.0 / 30.0) == pytest.approx(0.0, abs=0.2)
    assert highest(1.0, 12.0) == -20.0


def test_the_inertia_is_bounded_by_what_the_springs_damp() -> None:
    # B² / (0.36 K) = 0.417 kg·m²; half of 20 N·m on that.
    np.testing.assert_allclose(BrakingDistance.of(ARM, SafetyConfig(), LIMITS).deceleration_rad_s2, 24.0)
    told = BrakingDistance.of(ARM, SafetyConfig(deceleration_rad_s2=(3.0, 4.0)), LIMITS)
    np.testing.assert_array_equal(told.deceleration_rad_s2, [3.0, 4.0])


def test_joints_without_limits_are_never_braked() -> None:
    endless = dataclasses.replace(LIMITS, low_rad=np.full(2, -np.inf), high_rad=np.full(2, np.inf))
    free = permitted(dataclasses.replace(RULE, limits=endless), np.zeros(2), np.array([50.0, -50.0]))
    assert np.all(free.high_nm == np.inf) and np.all(free.low_nm == -np.inf)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_an_arm_pushed_outward_with_all_its_effort_stops_about_its_limit(side: float) -> None:
    """From two radians away; without the rule the shoulder is 0.5 rad beyond and hits its stop."""
    layer = SafetyLayer(ARM, SafetyConfig(), 500.0)
    arm = TwoLinkArm(q=(side * 0.8, side * 0.5))
    furthest = 0.0
    for k in range(1000):
        q, v = np.array(arm.q), np.array(arm.v)
        furthest = max(furthest, side * q[0])
        wanted = side * np.array([20.0, 0.0]) - np.array([0.0, 15.0 * (q[1] - side * 0.5) + 1.5 * v[1]])
        arm.step(layer.permit(ArmState((k + 1) * 2_000_000, q, v), wanted).effort_nm, 0.002)
    assert furthest < 2.9 + 0.1
    assert side * arm.q[0] == pytest.approx(SOFT_RAD, abs=0.02)
