"""What the safety layer lets through: each rule, and all of them over random states and simulated joints."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from two_link import arm_config

from tel_ros.core.arm_state import ArmState
from tel_ros.core.config import SafetyConfig
from tel_ros.core.errors import ConfigError, EffortError
from tel_ros.core.safety.layer import SafetyLayer
from tel_ros.core.safety.motion_rules import MotionLimits, SoftLimits
from tel_ros.core.safety.rules import EffortRate, LastEffort

ARM = arm_config()
PERIOD_NS = 2_000_000
NO_RATE = SafetyConfig(effort_rate_nm_per_s=(1e9, 1e9))


def state(k: int, position: object = (0.0, 0.0), velocity: object = (0.0, 0.0)) -> ArmState:
    return ArmState(k * PERIOD_NS, np.array(position, dtype=float), np.array(velocity, dtype=float))


def layer(safety: SafetyConfig = NO_RATE, **values: object) -> SafetyLayer:
    return SafetyLayer(arm_config(**values), safety, 500.0)


def test_an_effort_that_no_rule_objects_to_passes_to_the_last_bit() -> None:
    wanted = np.array([0.1 + 0.2, -math.pi])
    effort, changed = layer(SafetyConfig()).permit(state(1), wanted)
    np.testing.assert_array_equal(effort, wanted)
    assert not changed.any()


@pytest.mark.parametrize("bad", [[math.nan, 0.0], [0.0, math.inf], [-math.inf, math.inf], [1.0]])
def test_an_effort_that_is_not_finite_is_refused_and_what_follows_grows_from_zero(bad: list[float]) -> None:
    safe = layer(SafetyConfig())
    for k in range(10):
        safe.permit(state(k), np.full(2, 10.0))
    with pytest.raises(EffortError, match="expected 2 finite numbers"):
        safe.permit(state(10), np.array(bad))
    assert safe.none().effort_nm.tolist() == [0.0, 0.0]
    assert safe.permit(state(11), np.full(2, 10.0)).effort_nm.tolist() == [4.0, 4.0]


def test_efforts_are_clipped_to_the_limit_and_the_joint_is_named() -> None:
    effort, changed = layer().permit(state(1), np.array([25.0, -3.0]))
    assert effort.tolist() == [20.0, -3.0]
    assert changed.tolist() == [True, False]


def test_an_effort_crosses_its_range_in_20_ms_by_default_and_falls_to_zero_at_once() -> None:
    safe = layer(SafetyConfig())
    rising = [safe.permit(state(k), np.full(2, 20.0)).effort_nm[0] for k in range(5)]
    np.testing.assert_allclose(rising, [4.0, 8.0, 12.0, 16.0, 20.0])
    assert safe.permit(state(5), np.zeros(2)).effort_nm.tolist() == [0.0, 0.0]
    safe.permit(state(6), np.full(2, 4.0))
    turned = [safe.permit(state(k), np.full(2, -20.0)).effort_nm[0] for k in (7, 8)]
    np.testing.assert_allclose(turned, [-4.0, -8.0])


@pytest.mark.parametrize("step_ns", [-5 * PERIOD_NS, 0, 150_000_000])
def test_after_a_time_jump_efforts_grow_from_zero(step_ns: int) -> None:
    safe = layer(SafetyConfig())
    for k in range(100, 110):
        safe.permit(state(k), np.full(2, 20.0))
    jumped = dataclasses.replace(state(109), time_ns=109 * PERIOD_NS + step_ns)
    assert safe.permit(jumped, np.full(2, 20.0)).effort_nm.tolist() == [4.0, 4.0]


def test_a_late_state_lets_efforts_grow_by_two_periods_at_most() -> None:
    safe = layer(SafetyConfig())
    safe.permit(state(0), np.zeros(2))
    np.testing.assert_allclose(safe.permit(state(4), np.full(2, 20.0)).effort_nm, [8.0, 8.0])


def test_letting_go_fades_as_slowly_as_efforts_may_grow_and_ends_at_zero() -> None:
    rate = EffortRate(np.array([1000.0, 1000.0]), period_s=0.002)
    assert rate.towards_zero(LastEffort(np.array([5.0, -1.5]), 0.002)).tolist() == [3.0, 0.0]


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_beyond_a_soft_limit_the_arm_is_pushed_back_whatever_is_wanted(side: float) -> None:
    safe = layer()
    safe.permit(state(0), np.zeros(2))  # it came there under command
    effort, changed = safe.permit(state(1, side * np.array([2.85, 0.0])), side * np.array([20.0, 1.0]))
    # 0.05 rad beyond: twice four times K.
    assert effort[0] == pytest.approx(-side * 2.0 * 60.0 * 0.05)
    assert changed.tolist() == [True, False]


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_joint_that_is_found_beyond_a_soft_limit_is_led_back_and_not_flung(side: float) -> None:
    safe = layer()
    inertia_kg_m2, position, velocity, fastest = 0.5, side * 2.85, 0.0, 0.0  # 0.05 rad beyond
    for k in range(1000):
        seen = state(k, (position, 0.0), (velocity, 0.0))
        effort = safe.permit(seen, side * np.array([20.0, 0.0])).effort_nm[0]  # outward, all the time
        if k == 0:
            assert effort == pytest.approx(0.0)  # neither further out nor thrown back
        velocity += 0.002 * effort / inertia_kg_m2
        position += 0.002 * velocity
        fastest = max(fastest, abs(velocity))
    assert side * position == pytest.approx(2.8, abs=2e-3)
    assert fastest < 1.1 * 0.05 * 15.0  # a share of the velocity limit; the stiff wall makes 1.1 rad/s of it


@pytest.mark.parametrize("why", ["states are late", "the driver refuses"])
def test_a_soft_limit_waits_for_a_joint_that_it_leads_back_while_the_motors_do_not_act(why: str) -> None:
    safe = layer()
    for k in range(100):  # the drive is known to answer
        effort = safe.permit(state(k), np.array([4.0, 0.0])).effort_nm
        safe.response.look(k * PERIOD_NS, effort, effort)
    leans = dataclasses.replace(
        state(0, (2.85, 0.0)),
        age_s=0.06 if why == "states are late" else 0.0,
        effort_nm=np.zeros(2) if why == "the driver refuses" else None,
    )
    safe.none()
    waiting = []
    for k in range(101, 136):  # 70 ms, in which the limit goes back by 0.05 rad: not yet a dead drive
        seen = dataclasses.replace(leans, time_ns=k * PERIOD_NS)
        waiting.append(-safe.permit(seen, np.zeros(2)).effort_nm[0])
    assert not safe.response.fault
    # Whenever the motors act again. Compressed by 0.05 rad the wall would push with 6 N·m; a silence is
    # noticed 20 ms after the command has become strong (2 N·m), and each period adds 0.18 N·m.
    assert max(waiting) < 2.0 + 0.18 * 12
    again = dataclasses.replace(leans, time_ns=136 * PERIOD_NS, age_s=0.0, effort_nm=None)
    assert -safe.permit(again, np.zeros(2)).effort_nm[0] < 2.0 + 0.18 * 12


def test_a_joint_that_is_led_back_and_goes_out_again_is_pushed_back_at_once() -> None:
    safe = layer()
    for k in range(100):
        # 0.2 s at 0.75 rad/s: the limit is in its place again.
        safe.permit(state(k, (2.85 + 1e-9 * k, 0.0)), np.zeros(2))
    effort = safe.permit(state(100, (2.85, 0.0)), np.array([20.0, 0.0])).effort_nm[0]
    assert effort == pytest.approx(-2.0 * 60.0 * 0.05)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_joint_well_above_its_velocity_limit_is_braked_whatever_is_wanted(side: float) -> None:
    safe = layer(position_min_rad=(-1e6, -1e6), position_max_rad=(1e6, 1e6))
    fast = side * np.array([20.0, 18.0])  # the limit is 15, braking begins at 18.75
    effort, _ = safe.permit(state(1, velocity=fast), side * np.full(2, 20.0))
    assert side * effort[0] == pytest.approx(-3.0 * 1.25)
    assert side * effort[1] == pytest.approx(3.0 * 0.75)


def test_an_effort_that_brakes_or_goes_inward_is_left_alone() -> None:
    safe = layer()
    wanted = np.array([-12.0, 12.0])
    effort, changed = safe.permit(state(1, (2.85, -2.85), (1.0, -1.0)), wanted)
    np.testing.assert_array_equal(effort, wanted)
    assert not changed.any()


def test_joints_without_limits_are_bounded_by_speed_and_effort_alone() -> None:
    free = {"position_min_rad": (-1e6, -1e6), "position_max_rad": (1e6, 1e6)}
    effort, _ = layer(**free).permit(state(1, (1e3, -1e3)), np.array([30.0, -30.0]))
    assert effort.tolist() == [20.0, -20.0]
    limits = SoftLimits.of(ARM, SafetyConfig())
    endless = dataclasses.replace(limits, low_rad=np.full(2, -np.inf), high_rad=np.full(2, np.inf))
    rule = MotionLimits(endless)
    permitted = rule.permitted(state(0, (1e9, -5.0), (3.0, 0.0)), LastEffort(np.zeros(2), 0.002))
    np.testing.assert_allclose(permitted.high_nm, 3.0 * (18.75 - np.array([3.0, 0.0])))


def test_over_random_states_the_effort_is_finite_within_limits_and_never_drives_outward_beyond() -> None:
    rng = np.random.default_rng(5)
    safe = layer(SafetyConfig())
    soft = safe.soft_limits
    for k in range(3000):
        q, v = rng.uniform(-3.5, 3.5, 2), rng.normal(0.0, 10.0, 2)
        wanted = rng.normal(0.0, 10.0 ** rng.uniform(-3, 6), 2)
        effort, changed = safe.permit(state(k, q, v), wanted)
        assert np.all(np.abs(effort) <= 20.0)
        assert changed.tolist() == (effort != wanted).tolist()
        assert np.all(effort[(q > soft.high_rad) & (v >= 0.0)] <= 0.0)
        assert np.all(effort[(q < soft.low_rad) & (v <= 0.0)] >= 0.0)
        assert np.all(effort[v > 18.75] <= 0.0)
        assert np.all(effort[v < -18.75] >= 0.0)


@pytest.mark.parametrize("inertia", [0.001, 0.003, 0.02])
def test_a_light_joint_that_is_pushed_outward_comes_to_rest_at_the_soft_limit(inertia: float) -> None:
    """The wrist of an iiwa: K 10, B 0 to 0.3, friction 0.5 N·m·s/rad, effort limit 300 N·m."""
    arm = arm_config(
        stiffness_nm_per_rad=(10.0, 10.0),
        damping_nms_per_rad=(0.0, 0.3),
        effort_limit_nm=(300.0, 300.0),
        velocity_limit_rad_s=(10.0, 10.0),
    )
    safe, q, v, efforts = SafetyLayer(arm, SafetyConfig(), 500.0), np.zeros(2), np.zeros(2), []
    for k in range(1500):
        efforts.append(safe.permit(state(k, q, v), np.full(2, 300.0)).effort_nm)
        for _ in range(20):  # friction is stiff
            v = v + (efforts[-1] - 0.5 * v) / inertia * 1e-4
            q = q + v * 1e-4
    np.testing.assert_allclose(q, 2.8, atol=5e-3)
    assert np.ptp(efforts[-200:], axis=0).max() < 0.01


@pytest.mark.parametrize(
    ("key", "values", "expected"),
    [
        ("effort_rate_nm_per_s", (1.0,), "one for each of the joints shoulder, elbow"),
        ("soft_margin_rad", (0.1, 3.0), "less than half of each joint's range"),
    ],
)
def test_numbers_that_do_not_fit_the_arm_are_refused(
    key: str, values: tuple[float, ...], expected: str
) -> None:
    with pytest.raises(ConfigError, match=expected):
        layer(SafetyConfig(**{key: values}))


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("effort_rate_nm_per_s", (0.0, 1.0)),
        ("soft_margin_rad", (math.nan, 0.1)),
        ("k_position_per_s", (-1.0, 1.0)),
        ("k_velocity_nms_per_rad", (math.inf, 1.0)),
        ("deceleration_rad_s2", (0.0, 1.0)),
        ("velocity_margin", -0.1),
        ("command_timeout_s", 0.0),
        ("final_effort", "off"),
    ],
)
def test_numbers_that_make_no_sense_are_refused(key: str, value: object) -> None:
    with pytest.raises(ConfigError, match=key):
        SafetyConfig(**{key: value})


def test_a_pulse_is_held_by_the_effort_limits_alone_and_has_to_be_finite() -> None:
    arm = arm_config()
    layer = SafetyLayer(arm, SafetyConfig(), 500.0)
    limit = np.array(arm.effort_limit_nm)
    np.testing.assert_array_equal(layer.permit_pulse(0.1 * limit).effort_nm, 0.1 * limit)
    np.testing.assert_array_equal(layer.permit_pulse(-9.0 * limit).effort_nm, -limit)
    with pytest.raises(EffortError):
        layer.permit_pulse(np.array([np.nan, 0.0]))
    np.testing.assert_array_equal(layer.last_nm, 0.0)
