"""Practice that leads nowhere is noticed; practice that is merely slow, noisy or finished is left alone."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pytest

from tel_ros.core.errors import ConfigError
from tel_ros.core.practice.lock_up import LockUpMonitor

Trial = tuple[float, float, float]
"""Tracking error, training error before and after training, in mrad."""

NARROW_GAUSSIANS: list[Trial] = [
    *((229.28, 229.23, 7.72), (119.86, 119.69, 12.02), (68.69, 61.72, 9.30), (58.76, 30.23, 7.11)),
    *((45.62, 20.67, 4.08), (35.19, 13.41, 2.79), (29.42, 9.71, 1.86), (28.01, 5.11, 1.32)),
    *((27.85, 3.31, 1.08), (27.49, 2.39, 0.89), (27.17, 2.08, 0.79), (27.24, 1.76, 0.78)),
]
"""config/paper.yaml, practice.strategy=direct, learning.gaussians_per_input=40: a real lock-up."""

DESIRED_TRAINING: list[Trial] = [
    *((229.28, 229.23, 209.63), (264.35, 413.01, 408.52), (260.31, 357.65, 251.23)),
]
"""config/paper.yaml, practice.strategy=direct, learning.training=desired; the third trial was aborted."""

SLOW_LEARNING: list[Trial] = [
    *((25.82, 15.69, 10.32), (19.48, 13.89, 9.06), (14.25, 12.14, 7.96), (12.10, 11.25, 7.50)),
    *((11.94, 10.46, 6.99), (12.85, 9.62, 6.83), (14.75, 9.69, 6.72), (17.26, 10.42, 7.22)),
]
"""config/paper.yaml, practice.strategy=direct, learning.rate=0.05, learning.passes=1; trials 7 to 14."""

NO_ALARM: dict[str, list[Trial]] = {
    "slow but steady": [
        # config/paper.yaml, practice.strategy=direct
        *((229.28, 229.23, 10.50), (103.37, 94.96, 13.24), (88.39, 35.20, 7.01), (77.83, 18.85, 6.49)),
        *((72.65, 12.98, 5.03), (66.79, 11.49, 4.02), (63.45, 9.10, 3.39), (58.51, 7.92, 2.61)),
        *((51.72, 8.11, 2.29), (45.43, 7.86, 2.45), (40.09, 7.71, 2.15), (35.54, 7.98, 1.92)),
        *((32.56, 9.11, 2.05), (29.89, 9.45, 2.36), (27.88, 8.04, 2.91)),
    ],
    "a network that is too small": [
        # the same, learning.gaussians_per_input=3, learning.max_subtrees=0
        *((229.28, 229.23, 44.14), (66.41, 57.21, 22.14), (31.13, 29.05, 13.66), (14.23, 14.15, 12.71)),
        *((13.32, 12.83, 14.12), (13.78, 14.00, 13.85), (14.09, 13.24, 11.77), (12.55, 11.84, 12.46)),
        (12.28, 12.53, 15.03),
    ],
    "solved trees that converge in noise": [
        # config/planar_arm.yaml, practice.strategy=direct, sim.position_noise_rad=1e-3
        *((229.28, 229.23, 5.68), (94.67, 71.35, 10.93), (41.39, 30.70, 13.72), (21.21, 16.73, 7.57)),
        *((5.47, 8.29, 5.96), (3.43, 5.34, 4.14), (2.62, 3.42, 2.20), (1.50, 2.47, 1.81), (1.36, 1.78, 1.61)),
        *((1.30, 1.53, 1.34), (1.22, 1.57, 1.31), (1.11, 1.52, 1.26), (1.22, 1.28, 1.20), (1.20, 1.28, 1.20)),
    ],
    "solved trees with dry friction": [
        # the same without noise, sim.coulomb_friction_nm=[0.3,0.3]
        *((233.11, 233.06, 7.31), (101.82, 84.76, 14.53), (40.42, 34.46, 16.68), (10.87, 14.82, 6.80)),
        *((3.96, 6.93, 5.27), (2.51, 5.10, 3.59), (1.64, 3.68, 2.80), (1.25, 3.13, 2.10), (1.04, 2.18, 1.57)),
        *((0.89, 1.51, 1.27), (0.90, 1.28, 1.11), (0.86, 1.16, 1.01), (0.84, 1.02, 0.93), (0.81, 0.99, 0.90)),
    ],
}


def messages(
    trials: Sequence[Trial], *, alphas: Sequence[float] | None = None, tolerance_mrad: float = 2.0
) -> list[str]:
    monitor = LockUpMonitor(1e-3 * tolerance_mrad)
    alphas = alphas or [1.0] * len(trials)
    return [
        monitor.after_trial(alpha, *(1e-3 * mrad for mrad in trial))
        for alpha, trial in zip(alphas, trials, strict=True)
    ]


def test_a_real_lock_up_is_found_when_the_tracking_error_stands_still() -> None:
    found = messages(NARROW_GAUSSIANS)
    assert found[:8] == [""] * 8
    assert all(message and message.startswith("learning lock-up") for message in found[8:])
    assert "29.4 mrad to 27.9 mrad" in str(found[8])
    assert "9.71 mrad to 3.31 mrad" in str(found[8])


def test_desired_training_at_goal_speed_is_found_to_diverge() -> None:
    *earlier, last = messages(DESIRED_TRAINING)
    assert earlier == ["", ""]
    assert last != ""
    assert "learning diverges" in last
    assert "229 mrad to 260 mrad" in last


def test_an_error_that_fell_and_grows_again_is_found_to_diverge() -> None:
    *earlier, last = messages(SLOW_LEARNING)
    assert earlier == [""] * 7
    assert str(last).startswith("learning diverges")


@pytest.mark.parametrize("name", NO_ALARM)
def test_practice_that_gets_somewhere_or_cannot_is_no_lock_up(name: str) -> None:
    """Even if the tolerance is below what can be reached."""
    assert messages(NO_ALARM[name], tolerance_mrad=0.5) == [""] * len(NO_ALARM[name])


def test_an_error_within_the_tolerance_is_good_enough_however_much_smaller_the_training_error_is() -> None:
    converged = [(0.40, 0.2, 0.1), (0.41, 0.1, 0.1), (0.40, 0.05, 0.05), (0.45, 0.05, 0.05)]
    assert messages(converged, tolerance_mrad=0.5) == [""] * 4
    assert messages(converged, tolerance_mrad=0.3)[2] != ""


def test_the_speed_that_rises_is_not_held_against_the_network() -> None:
    rising = [(3.7, 4.0, 1.0), (5.6, 2.5, 1.0), (8.7, 1.5, 1.0), (13.4, 1.0, 0.5), (21.3, 0.8, 0.4)]
    assert messages(rising, alphas=[0.6, 0.7, 0.8, 0.9, 1.0]) == [""] * 5
    assert messages(rising)[2] != ""


def test_standing_still_is_counted_from_the_first_trial_at_the_speed() -> None:
    stuck = [(28.0, 5.0, 1.0)] * 5
    found = messages(stuck, alphas=[0.9, 0.9, 1.0, 1.0, 1.0])
    assert [message != "" for message in found] == [False, False, False, False, True]


def test_noise_about_a_floor_is_no_lock_up() -> None:
    rng = np.random.default_rng(1)
    floor = [tuple(row) for row in np.array([4.0, 4.0, 3.6]) * (1.0 + 0.1 * rng.standard_normal((200, 3)))]
    lock_ups = [message for message in messages(floor) if message and "lock-up" in message]
    assert lock_ups == []


def test_an_error_that_jumps_and_is_being_learned_away_is_no_divergence() -> None:
    """As with a payload that is put on between two trials."""
    payload = [(7.3, 7.5, 3.0), (57.9, 52.0, 5.0), (17.6, 15.0, 4.0), (5.6, 5.0, 3.0)]
    assert messages(payload) == [""] * 4


def test_trials_that_told_nothing_are_passed_over() -> None:
    nothing = (math.nan, math.nan, math.nan)
    found = messages([NARROW_GAUSSIANS[6], nothing, NARROW_GAUSSIANS[7], nothing, NARROW_GAUSSIANS[8]])
    assert [message != "" for message in found] == [False, False, False, False, True]


@pytest.mark.parametrize("tolerance_rad", [0.0, -1.0, math.nan, math.inf])
def test_a_tolerance_that_is_no_angle_is_refused(tolerance_rad: float) -> None:
    with pytest.raises(ConfigError, match="tolerance_rad is .*; expected a finite angle above 0 rad"):
        LockUpMonitor(tolerance_rad)
