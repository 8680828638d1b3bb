"""The quick test in place of all rules is derived from them: it says yes only where each of them does."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from two_link import arm_config

from tel_ros.core.arm_state import ArmState
from tel_ros.core.config import ArmConfig, SafetyConfig
from tel_ros.core.safety.layer import SafetyLayer
from tel_ros.core.safety.rules import (
    ANY_EFFORT,
    EffortRange,
    LastEffort,
    QuietBounds,
    QuietZone,
    SafetyRule,
)

PERIOD_NS = 2_000_000
ARMS = {
    "planar": arm_config(),
    "wide": arm_config(position_min_rad=(-1e9, -1.0), position_max_rad=(1e9, 2.0)),
    "narrow": arm_config(position_min_rad=(-0.2, 0.5), position_max_rad=(0.2, 0.6)),
}


class Objector(SafetyRule):
    """Permits no effort to a joint in the middle of everything, where no other rule objects."""

    def permitted(self, state: ArmState, last: LastEffort) -> EffortRange:
        """Return no effort near 0.5 rad."""
        high = np.where(np.abs(state.position_rad - 0.5) < 0.1, 0.0, np.inf)
        return EffortRange(-high, high)


class CarefulObjector(Objector):
    """Tells where it does not object."""

    def quiet(self) -> QuietBounds:
        """Return positions well below 0.5 rad."""
        return QuietBounds(high_rad=np.array(0.35))


class Silent(SafetyRule):
    """Never objects, but does not say so."""

    def permitted(self, state: ArmState, last: LastEffort) -> EffortRange:
        """Return any effort."""
        return ANY_EFFORT


class Counted:
    """A zone that counts how often it says yes."""

    def __init__(self, zone: QuietZone) -> None:
        self.zone, self.yes = zone, 0

    def has(self, *question: object) -> bool:
        """Return what the zone says."""
        answer = self.zone.has(*question)
        self.yes += answer
        return answer


def counted(layer: SafetyLayer) -> Counted:
    layer._quiet = zone = Counted(layer._quiet)
    return zone


def wandering(arm: ArmConfig, rng: np.random.Generator, steps: int) -> list[tuple[ArmState, np.ndarray]]:
    """Return states and efforts that come near every bound and beyond it, now and then late."""
    low = np.maximum(arm.position_min_rad, -3.0)
    high = np.minimum(arm.position_max_rad, 3.0)
    fast, strong = np.array(arm.velocity_limit_rad_s), np.array(arm.effort_limit_nm)
    time_ns, effort, rows = 0, np.zeros(2), []
    scale = rng.choice([0.3, 0.3, 1.0, 1.3], size=(steps, 3))
    for k in range(steps):
        time_ns += int(rng.choice([PERIOD_NS] * 8 + [PERIOD_NS // 3, 4 * PERIOD_NS, 30 * PERIOD_NS]))
        q = 0.5 * (low + high) + scale[k, 0] * rng.uniform(-0.5, 0.5, 2) * (high - low)
        v = scale[k, 1] * rng.uniform(-1.0, 1.0, 2) * fast
        effort = np.clip(effort + scale[k, 2] * rng.uniform(-1.6, 1.6, 2), -1.2 * strong, 1.2 * strong)
        rows.append((ArmState(time_ns, q, v), effort))
    return rows


@pytest.mark.parametrize("name", ARMS)
def test_the_zone_changes_nothing_in_what_the_layer_permits(name: str) -> None:
    rows = wandering(ARMS[name], np.random.default_rng(7), 4000)
    quick = SafetyLayer(ARMS[name], SafetyConfig(), 500.0)
    slow = SafetyLayer(ARMS[name], SafetyConfig(), 500.0, own_rules=[Silent()])
    zone, never = counted(quick), counted(slow)
    for state, wanted in rows:
        one, other = quick.permit(state, wanted), slow.permit(state, wanted)
        np.testing.assert_array_equal(one.effort_nm, other.effort_nm)
        np.testing.assert_array_equal(one.changed, other.changed)
    assert never.yes == 0
    if name == "planar":
        assert 100 < zone.yes < 3800  # both ways have been tried


@pytest.mark.parametrize(("rule", "uses_the_zone"), [(Objector(), False), (CarefulObjector(), True)])
def test_a_new_rule_is_heard_where_nothing_else_objects(rule: SafetyRule, uses_the_zone: bool) -> None:
    without, layer = (SafetyLayer(ARMS["planar"], SafetyConfig(), 500.0, own_rules=r) for r in ((), [rule]))
    before, zone, wanted = counted(without), counted(layer), np.array([0.3, -0.2])
    for k in range(1, 200):
        q = 0.005 * k
        state = ArmState(k * PERIOD_NS, np.full(2, q), np.full(2, 2.5))
        without.permit(state, wanted)
        effort, changed = layer.permit(state, wanted)
        if abs(q - 0.5) < 0.1 - 1e-9:
            np.testing.assert_array_equal(effort, 0.0)
            assert changed.all()
        elif q < 0.4:
            np.testing.assert_array_equal(effort, wanted)
            assert not changed.any()
    assert before.yes == 198  # all but the first: nothing else objects
    assert (zone.yes > 50) is uses_the_zone


def test_rules_with_different_dampings_have_no_zone_in_common() -> None:
    one, other = (QuietBounds(damping_nms_per_rad=k * np.ones(2), damped_nm=np.ones(2)) for k in (1.0, 2.0))
    still = ArmState(0, np.zeros(2), np.zeros(2))
    assert QuietZone([one, one], 2).has(still, np.zeros(2), np.zeros(2), 10)
    assert not QuietZone([one, other], 2).has(still, np.zeros(2), np.zeros(2), 10)


def in_the_zone(layer: SafetyLayer, position: object, wanted: object = (0.0, 0.0)) -> bool:
    state = ArmState(PERIOD_NS, np.array(position), np.zeros(2))
    return layer._quiet.has(state, np.array(wanted), np.zeros(2), PERIOD_NS)


def test_a_joint_near_a_soft_limit_is_never_in_the_zone() -> None:
    assert not in_the_zone(SafetyLayer(ARMS["narrow"], SafetyConfig(), 500.0), (0.0, 0.55))


def test_a_joint_without_limits_is_in_the_zone_wherever_it_is() -> None:
    layer = SafetyLayer(ARMS["planar"], SafetyConfig(), 500.0)
    assert not in_the_zone(layer, (100.0, -100.0))
    endless = dataclasses.replace(
        layer.soft_limits, low_rad=np.full(2, -math.inf), high_rad=np.full(2, math.inf)
    )
    bounds = [
        dataclasses.replace(rule, limits=endless).quiet() if hasattr(rule, "limits") else rule.quiet()
        for rule in layer.rules
    ]
    layer._quiet = QuietZone(bounds, 2)
    assert in_the_zone(layer, (100.0, -100.0))


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_an_effort_that_is_not_finite_is_not_in_the_zone(bad: float) -> None:
    layer = SafetyLayer(ARMS["planar"], SafetyConfig(), 500.0)
    assert in_the_zone(layer, (0.0, 0.0))
    assert not in_the_zone(layer, (0.0, 0.0), (bad, 0.0))
