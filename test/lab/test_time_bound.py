"""The time-optimal bound of a path: known solutions, and a movement of the default arm."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import brentq

from tel_lab.exact_model import ExactInverseDynamics
from tel_lab.random_path import random_smooth_path
from tel_lab.time_bound import time_bound
from tel_ros.core.config import Config
from tel_ros.core.errors import TrajectoryError
from tel_ros.core.learning.inputs import query_inputs
from tel_ros.core.practice.learned_timings import LearnedTimings
from tel_ros.core.practice.session import Prediction
from tel_ros.core.practice.strategy import Movement
from tel_ros.core.trajectories.paths import NAMED_PATHS
from tel_ros.core.trajectories.paths import Path as JointPath
from tel_ros.core.trajectories.trajectory import DesiredTrajectory
from tel_ros.core.types import FloatArray
from tel_ros.recording.config_file import load_config

pytest.importorskip("toppra")
INERTIA_KGM2 = 0.8


@pytest.fixture(scope="module")
def config() -> Config:
    return load_config(Path(__file__).parents[2] / "config" / "planar_arm.yaml", [])


def straight(distance_rad: float) -> JointPath:
    """The first joint goes so far, the second half as far."""
    way = distance_rad * np.array([1.0, 0.5])
    return JointPath(
        "straight", 2, lambda s: (s[:, None] * way, np.tile(way, (len(s), 1)), np.zeros((len(s), 2)))
    )


class Wheels:
    """Two equal joints that do not influence each other."""

    def __init__(
        self, config: Config, viscous: float = 0.0, dry_nm: float = 0.0, load_nm: float = 0.0
    ) -> None:
        self.arm, self._friction, self._load_nm = config.arm, (viscous, dry_nm), load_nm

    def __call__(self, inputs: FloatArray) -> FloatArray:
        _, v, a = np.split(inputs, 3, axis=1)
        viscous, dry_nm = self._friction
        torque_nm = INERTIA_KGM2 * a + viscous * v + dry_nm * np.sign(v) + self._load_nm
        damping, stiffness = np.array(self.arm.damping_nms_per_rad), np.array(self.arm.stiffness_nm_per_rad)
        return (torque_nm + damping * v) / stiffness


@pytest.mark.parametrize(("viscous", "dry_nm"), [(1e-6, 0.0), (3.0, 0.0), (3.0, 2.0)])
def test_the_bound_of_a_wheel_with_friction_is_that_of_full_effort_both_ways(
    config: Config, viscous: float, dry_nm: float
) -> None:
    limit_nm, distance_rad = config.arm.effort_limit_nm[0], 1.5
    constant_s = INERTIA_KGM2 / viscous
    up, down = (limit_nm - dry_nm) / viscous, (limit_nm + dry_nm) / viscous

    def times_s(peak: float) -> tuple[float, float]:
        return -constant_s * math.log1p(-peak / up), constant_s * math.log1p(peak / down)

    def beyond(peak: float) -> float:
        rising_s, falling_s = times_s(peak)
        return up * rising_s - down * falling_s - distance_rad

    peak = brentq(beyond, 1e-3, min(0.999 * up, 20.0))
    found = time_bound(config.arm, Wheels(config, viscous, dry_nm), straight(distance_rad))
    assert found.duration_s == pytest.approx(sum(times_s(peak)), rel=2e-3)


def test_a_speed_limit_bounds_what_efforts_would_allow(config: Config) -> None:
    free = time_bound(config.arm, Wheels(config), straight(100.0))
    assert np.max(100.0 * free.rate) == pytest.approx(config.arm.velocity_limit_rad_s[0], rel=1e-3)


def test_half_of_the_effort_takes_the_root_of_two_times_as_long_without_friction(config: Config) -> None:
    whole, half = (time_bound(config.arm, Wheels(config), straight(1.5), share) for share in (1.0, 0.5))
    assert half.duration_s == pytest.approx(math.sqrt(2.0) * whole.duration_s, rel=1e-3)


def test_an_arm_that_cannot_hold_its_load_has_no_bound(config: Config) -> None:
    load_nm = 1.1 * config.arm.effort_limit_nm[0]
    with pytest.raises(TrajectoryError, match="cannot run the path straight within its effort limits"):
        time_bound(config.arm, Wheels(config, load_nm=load_nm), straight(1.5))


def test_the_loops_of_the_default_arm_can_be_run_in_1_4_seconds(config: Config) -> None:
    """As found with the toppra package and a model of the arm of its own, within 0.5 %."""
    model = ExactInverseDynamics(config, config.sim).predict
    found = time_bound(config.arm, model, NAMED_PATHS["planar_loops"])
    assert found.duration_s == pytest.approx(1.41, rel=5e-3)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_practice_plans_movements_that_come_near_the_bound_of_the_efforts_that_it_may_use(
    config: Config, seed: int
) -> None:
    """Bounded rates of effort, and room below the velocity limits, cost it 2 to 4 %."""
    model = ExactInverseDynamics(config, config.sim).predict
    path = random_smooth_path(seed, (-2.3, -2.3), (2.3, 2.3))

    def predict(desired: DesiredTrajectory) -> Prediction:
        offset_rad = model(query_inputs(desired, 1.0 / config.control.rate_hz))
        return Prediction(desired.position_rad + offset_rad, np.zeros_like(offset_rad))

    share = config.practice.effort_share
    planned = LearnedTimings(config, path, None).of(Movement(1.0, effort_share=share), predict)
    assert 1.0 < planned.duration_s / time_bound(config.arm, model, path, share, 500).duration_s < 1.05
