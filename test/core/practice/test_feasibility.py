"""Movements that the velocity limits do not allow are found before anything moves."""

from __future__ import annotations

import dataclasses
import re

import numpy as np
import pytest
from two_link import arm_config

from tel_ros.core.config import Config, PathConfig, PracticeConfig
from tel_ros.core.control.tracking import Limits
from tel_ros.core.errors import ConfigError
from tel_ros.core.practice.feasibility import require_within_velocity_limits
from tel_ros.core.practice.movement_path import desired_trajectory
from tel_ros.core.practice.strategies import make_strategy
from tel_ros.core.practice.strategy import Movement
from tel_ros.core.trajectories.paths import NAMED_PATHS, Path, waypoint_path
from tel_ros.core.trial import TrialGoal

LOOPS = NAMED_PATHS["planar_loops"]
FAR = waypoint_path("far", np.array([[-2.0, 0.5], [2.0, 0.6], [-2.0, 0.5]]))


def limited(velocity_rad_s: tuple[float, float], **practice: object) -> Config:
    """Return a configuration of practice by an arm with these velocity limits."""
    known = "planar_loops" if "shape" in practice.get("vary", ()) else ""
    return Config(
        arm=dataclasses.replace(arm_config(), velocity_limit_rad_s=velocity_rad_s),
        path=PathConfig(name="planar_loops", known_name=known),
        practice=PracticeConfig(**practice),
    )


def check(config: Config, path: Path, known: Path | None) -> None:
    require_within_velocity_limits(config, make_strategy(config).fastest_movements(), path, known)


def peaks(path: Path, duration_s: float) -> np.ndarray:
    return np.abs(desired_trajectory(path, None, Movement(duration_s), 1000.0).velocity_rad_s).max(axis=0)


def refusal(config: Config, known: Path | None = None) -> ConfigError:
    with pytest.raises(ConfigError) as error:
        check(config, LOOPS, known)
    return error.value


ALL = ["trajectory_extension", "adaptive_extension", "subtasks", "direct"]


@pytest.mark.parametrize("strategy", ALL)
def test_a_goal_that_is_too_fast_is_refused_with_joint_speed_limit_and_shortest_duration(
    strategy: str,
) -> None:
    shoulder, elbow = peaks(LOOPS, 4.5)
    error = refusal(limited((2.0 * shoulder, 0.9 * elbow), goal_duration_s=4.5, strategy=strategy))
    assert (error.key, error.value) == ("practice.goal_duration_s", 4.5)
    assert "elbow would move at" in error.expected
    assert f"allows it {0.9 * elbow:g} rad/s" in error.expected
    least_s = float(re.match(r"at least (\S+) s", error.expected)[1])
    # A part of the path starts and stops, and so is faster than the whole.
    assert least_s >= 4.5 / 0.9 if strategy == "subtasks" else least_s == pytest.approx(4.5 / 0.9, abs=0.011)


@pytest.mark.parametrize("strategy", ALL)
@pytest.mark.parametrize("share", [0.3, 0.77, 0.999])
def test_the_duration_that_is_suggested_is_one_that_the_controller_takes(strategy: str, share: float) -> None:
    limit = tuple(share * peaks(LOOPS, 4.5))
    error = refusal(limited(limit, goal_duration_s=4.5, first_duration_s=60.0, strategy=strategy))
    least_s = float(re.match(r"at least (\S+) s", error.expected)[1])
    config = limited(limit, goal_duration_s=least_s, first_duration_s=60.0, strategy=strategy)
    check(config, LOOPS, None)
    desired = desired_trajectory(LOOPS, None, Movement(least_s), 500.0)
    limits = dataclasses.replace(
        Limits.of(config.arm, 1.0),
        position_min_rad=np.full(2, -10.0),
        position_max_rad=np.full(2, 10.0),
    )
    limits.check_goal(TrialGoal(1, 1.0, desired, desired.position_rad), 0.01)


@pytest.mark.parametrize("strategy", ALL)
def test_practice_within_the_limits_is_not_refused(strategy: str) -> None:
    check(limited((50.0, 50.0), strategy=strategy), LOOPS, None)


def test_of_a_list_of_durations_only_those_that_come_count() -> None:
    limit = tuple(peaks(LOOPS, 6.0) * 1.001)
    durations_s = (9.0, 6.0)
    allowed = limited(limit, strategy="trajectory_extension", goal_duration_s=4.5, durations_s=durations_s)
    check(allowed, LOOPS, None)
    error = refusal(
        limited(limit, strategy="trajectory_extension", goal_duration_s=4.5, durations_s=(9.0, 5.0))
    )
    assert (error.key, error.value) == ("practice.durations_s", 5.0)


def test_the_known_path_that_practice_begins_with_has_to_be_slow_enough_too() -> None:
    limit = tuple(1.001 * np.maximum(peaks(LOOPS, 4.5), 0.5 * peaks(FAR, 4.5)))
    asked = {"strategy": "adaptive_extension", "goal_duration_s": 4.5}
    error = refusal(limited(limit, vary=("shape",), **asked), FAR)
    assert error.key == "practice.goal_duration_s"
    assert "shoulder would move at" in error.expected
    assert "on the known path" in error.expected


def test_a_known_path_that_is_only_practised_slowly_may_be_too_fast_for_the_goal_duration() -> None:
    limit = tuple(1.001 * np.maximum(peaks(LOOPS, 4.5), peaks(FAR, 30.0)))
    assert np.any(np.array(limit) < peaks(FAR, 5.0))
    asked = {"strategy": "adaptive_extension", "goal_duration_s": 4.5, "vary": ("shape", "speed")}
    check(limited(limit, first_duration_s=30.0, **asked), LOOPS, FAR)
    error = refusal(limited(limit, first_duration_s=5.0, **asked), FAR)
    assert (error.key, error.value) == ("practice.first_duration_s", 5.0)


def test_amplitude_makes_a_movement_slower_only_until_the_goal_is_reached() -> None:
    limit = tuple(0.6 * peaks(LOOPS, 4.5))
    asked = {"strategy": "adaptive_extension", "goal_duration_s": 4.5, "vary": ("amplitude",)}
    assert refusal(limited(limit, first_amplitude=0.5, **asked)).value == 4.5
