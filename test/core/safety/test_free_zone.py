"""The one test in place of all rules may only say yes where each of them does."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from two_link import arm_config

from tel_ros.core.arm_state import ArmState
from tel_ros.core.config import ArmConfig, SafetyConfig
from tel_ros.core.safety.free_zone import FreeZone
from tel_ros.core.safety.layer import SafetyLayer

PERIOD_NS = 2_000_000
ARMS = {
    "planar": arm_config(),
    "wide": arm_config(position_min_rad=(-1e9, -1.0), position_max_rad=(1e9, 2.0)),
    "narrow": arm_config(position_min_rad=(-0.2, 0.5), position_max_rad=(0.2, 0.6)),
}


class Never:
    """A zone that has nothing in it: every rule is asked."""

    shortest_ns = 0

    def has(self, state: ArmState, wanted_nm: object, last_nm: object) -> bool:
        """Return False."""
        return False


class Counted:
    """A zone that counts what it has."""

    def __init__(self, zone: FreeZone) -> None:
        self.zone, self.shortest_ns, self.yes = zone, zone.shortest_ns, 0

    def has(self, state: ArmState, wanted_nm: np.ndarray, last_nm: np.ndarray) -> bool:
        """Return what the zone says."""
        answer = self.zone.has(state, wanted_nm, last_nm)
        self.yes += answer
        return answer


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
    quick, slow = (SafetyLayer(ARMS[name], SafetyConfig(), 500.0) for _ in range(2))
    quick._free = counted = Counted(quick._free)
    slow._free = Never()
    for state, wanted in rows:
        one, other = quick.permit(state, wanted), slow.permit(state, wanted)
        np.testing.assert_array_equal(one.effort_nm, other.effort_nm)
        np.testing.assert_array_equal(one.changed, other.changed)
    if name == "planar":
        assert 100 < counted.yes < 3800  # both ways have been tried


def test_a_joint_near_a_soft_limit_is_never_in_the_zone() -> None:
    layer = SafetyLayer(ARMS["narrow"], SafetyConfig(), 500.0)
    state = ArmState(PERIOD_NS, np.array([0.0, 0.55]), np.zeros(2))
    assert not layer._free.has(state, np.zeros(2), np.zeros(2))


def test_a_joint_without_limits_is_in_the_zone_wherever_it_is() -> None:
    layer = SafetyLayer(ARMS["planar"], SafetyConfig(), 500.0)
    endless = dataclasses.replace(
        layer.motion, soft_min_rad=np.full(2, -math.inf), soft_max_rad=np.full(2, math.inf)
    )
    zone = FreeZone.of(layer.rate, layer.braking, endless, layer.limit, 0.002)
    far = ArmState(PERIOD_NS, np.array([100.0, -100.0]), np.zeros(2))
    assert zone.has(far, np.zeros(2), np.zeros(2))
    assert not layer._free.has(far, np.zeros(2), np.zeros(2))


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_an_effort_that_is_not_finite_is_not_in_the_zone(bad: float) -> None:
    layer = SafetyLayer(ARMS["planar"], SafetyConfig(), 500.0)
    middle = ArmState(PERIOD_NS, layer._free.centre_rad, np.zeros(2))
    assert layer._free.has(middle, np.zeros(2), np.zeros(2))
    assert not layer._free.has(middle, np.array([bad, 0.0]), np.zeros(2))
