"""Random arms: as far from the configured one as they say, and the same for the same seed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sim_bridge.arm import SimulatedArm
from tel_lab.random_arm import (
    FAR,
    NEAR,
    NOMINAL_VISCOUS_FRICTION_NMS_PER_RAD,
    ArmVariation,
    Range,
    vary,
)
from tel_ros.core.config import SimConfig
from tel_ros.core.errors import ConfigError
from tel_ros.recording.config_file import load_config
from tel_ros.recording.urdf import described

CONFIG = load_config(Path(__file__).parents[2] / "config" / "planar_arm.yaml")

N = 300
"""So many even draws come within 5 % of an end of their range but for 0.95^300 = 2e-7 of the cases."""


def assert_fills(values: list[float], limits: Range) -> None:
    low, high = limits
    rounding = 1e-12 * high
    assert low - rounding <= min(values) <= low + 0.05 * (high - low)
    assert high - 0.05 * (high - low) <= max(values) <= high + rounding


@pytest.mark.parametrize("variation", [NEAR, FAR], ids=["near", "far"])
def test_arms_vary_as_far_as_the_variation_says(variation: ArmVariation) -> None:
    base = SimConfig(
        inertia_scale=3.0,
        payload_kg=0.2,
        viscous_friction_nms_per_rad=(0.1, 0.4),
        coulomb_friction_nm=(0.0, 0.5),
        position_noise_rad=0.1,
    )
    arms = [vary(base, seed, variation) for seed in range(N)]
    assert_fills([arm.inertia_scale / 3.0 for arm in arms], variation.inertia)
    assert_fills([arm.position_noise_rad for arm in arms], variation.position_noise_rad)
    assert_fills([arm.payload_kg - 0.2 for arm in arms], variation.added_payload_kg)
    for joint in (0, 1):
        viscous, coulomb = base.viscous_friction_nms_per_rad[joint], base.coulomb_friction_nm[joint]
        assert_fills(
            [arm.viscous_friction_nms_per_rad[joint] / viscous for arm in arms], variation.viscous_friction
        )
        assert_fills(
            [arm.coulomb_friction_nm[joint] - coulomb for arm in arms], variation.added_coulomb_friction_nm
        )


def test_what_a_variation_does_not_name_stays() -> None:
    base = SimConfig(encoder_bits=14, command_delay_s=0.002, velocity_filter_hz=50.0)
    arm = vary(base, 4)
    assert (arm.encoder_bits, arm.command_delay_s, arm.velocity_filter_hz) == (14, 0.002, 50.0)
    assert arm.payload_kg == 0.0


def test_equal_seeds_give_equal_arms_and_others_give_others() -> None:
    assert vary(SimConfig(), 7) == vary(SimConfig(), 7)
    assert vary(SimConfig(), 7, FAR) == vary(SimConfig(), 7, FAR) != vary(SimConfig(), 7)
    assert len({vary(SimConfig(), seed).inertia_scale for seed in range(50)}) == 50


def test_joints_have_frictions_of_their_own() -> None:
    arm = vary(SimConfig(), 1, n_joints=3)
    assert len(set(arm.viscous_friction_nms_per_rad)) == len(set(arm.coulomb_friction_nm)) == 3


def test_the_nominal_frictions_are_those_of_the_urdf() -> None:
    description = described(CONFIG.arm)
    assert description.viscous_friction_nms_per_rad == (NOMINAL_VISCOUS_FRICTION_NMS_PER_RAD,) * 2
    assert description.coulomb_friction_nm == (0.0, 0.0)


def test_a_heavier_random_arm_is_harder_to_move() -> None:
    """The drawn values reach the physics."""
    sims = sorted((vary(SimConfig(), seed, FAR) for seed in range(20)), key=lambda sim: sim.inertia_scale)
    velocity = []
    for sim in (sims[0], sims[-1]):
        without_noise = replace(sim, position_noise_rad=0.0)
        with SimulatedArm(CONFIG.arm, without_noise, rate_hz=500.0, seed=1) as arm:
            for _ in range(20):
                arm.step([5.0, 0.0])
            velocity.append(arm.true_velocity_rad_s[0])
    assert velocity[0] > 1.5 * velocity[1] > 0.0


def test_a_negative_seed_is_refused() -> None:
    with pytest.raises(ConfigError, match="seed is -1; expected a whole number of at least 0"):
        vary(SimConfig(), -1)


def test_arms_are_as_often_lighter_as_heavier() -> None:
    arms = [vary(SimConfig(), seed) for seed in range(N)]
    scales = np.array([arm.inertia_scale for arm in arms])
    assert 0.95 < np.exp(np.log(scales).mean()) < 1.05  # even in the logarithm: 1 in the middle
