"""What a controller takes for rest is rest for the arm in lockstep, however much it swings."""

from __future__ import annotations

import numpy as np
import pytest

from sim_bridge.stillness import Stillness
from tel_ros.core.config import ControlConfig
from tel_ros.core.control.holding import RestDetector

CONTROL = ControlConfig(rate_hz=500.0, settle_time_s=0.2, settle_speed_rad_s=0.05)


@pytest.mark.parametrize("seed", range(20))
def test_whatever_the_controller_calls_rest_is_rest_here(seed: int) -> None:
    rng = np.random.default_rng(seed)
    detector = RestDetector(CONTROL.settle_speed_rad_s, CONTROL.settle_time_s)
    stillness = Stillness(CONTROL)
    amplitude, frequency_hz = rng.uniform(0.02, 0.2), rng.uniform(0.5, 10.0, 2)
    fast = 0
    for k in range(3000):
        t = k / 500.0
        swing = 2.0 * np.pi * frequency_hz
        position = amplitude * np.exp(-t) * np.sin(swing * t)
        if detector.at_rest(k * 2_000_000, position):
            # One more period passes with the last command.
            stillness.add(tuple(amplitude * np.exp(-t - 0.002) * np.sin(swing * (t + 0.002))))
            assert stillness.stands_still
            break
        stillness.add(tuple(position))
        fast = max(fast, k)
    assert fast > 100, "it came to rest at once"


def test_an_arm_in_motion_does_not_stand_still() -> None:
    stillness = Stillness(CONTROL)
    for k in range(200):
        stillness.add((0.0, 0.5 * k / 500.0))
    assert not stillness.stands_still


def test_an_arm_that_nobody_has_moved_stands_still() -> None:
    assert Stillness(CONTROL).stands_still
