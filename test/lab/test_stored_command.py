"""Commands that are corrected from trial to trial: they get better, are careful, and know one movement."""

from __future__ import annotations

import numpy as np
import pytest
from servo_joint import DAMPING_S, PERIOD_S, execute, rms_error, swing

from tel_lab.comparison.servo_methods import with_velocity_reference
from tel_lab.comparison.stored_command import (
    IterativeLearningControl,
    StoredCommand,
    VirtualTrajectoryLearning,
    zero_phase,
)
from tel_ros.core.errors import TrajectoryError
from tel_ros.core.trajectories.trajectory import DesiredTrajectory

Make = type[StoredCommand]
METHODS: list[Make] = [IterativeLearningControl, VirtualTrajectoryLearning]


def practised(make: Make, n_trials: int) -> list[float]:
    desired = swing()
    method = make(desired, with_velocity_reference(desired, DAMPING_S), PERIOD_S)
    errors = []
    for _ in range(n_trials):
        trial = execute(desired, method.command(desired))
        errors.append(rms_error(trial))
        method.learn(trial, completed=True)
    return errors


def test_iterative_learning_removes_nearly_all_of_the_error() -> None:
    errors = practised(IterativeLearningControl, 15)
    assert errors[-1] < 0.02 * errors[0]


def test_correcting_the_virtual_trajectory_lowers_the_error_of_a_slow_movement() -> None:
    errors = practised(VirtualTrajectoryLearning, 10)
    assert errors[-1] < 0.7 * errors[0]


@pytest.mark.parametrize("make", METHODS)
def test_after_an_abort_the_last_completed_command_returns_and_corrections_are_halved(
    make: Make,
) -> None:
    desired = swing()
    initial = desired.position_rad
    method, cautious = make(desired, initial, PERIOD_S), make(desired, initial, PERIOD_S)
    trial = execute(desired, initial)
    method.learn(trial, completed=True)
    full = method.command(desired) - zero_phase(initial, make.cutoff_hz, PERIOD_S)
    cautious.learn(execute(desired, initial, n_run=100), completed=False)
    np.testing.assert_array_equal(cautious.command(desired), initial)
    cautious.learn(trial, completed=True)
    halved = cautious.command(desired) - zero_phase(initial, make.cutoff_hz, PERIOD_S)
    np.testing.assert_allclose(halved, 0.5 * full, atol=1e-12)
    assert np.abs(full).max() > 1e-3


@pytest.mark.parametrize("make", METHODS)
@pytest.mark.parametrize(
    "other", [swing(duration_s=2.5), swing(amplitude_rad=0.4)], ids=["slower", "smaller"]
)
def test_there_is_no_command_for_another_movement(make: Make, other: DesiredTrajectory) -> None:
    desired = swing()
    method = make(desired, desired.position_rad, PERIOD_S)
    assert not method.transfers
    with pytest.raises(TrajectoryError, match="another movement"):
        method.command(other)


def test_the_filter_neither_delays_nor_bends_what_is_slow_and_removes_what_is_fast() -> None:
    time_s = np.arange(0.0, 4.0, PERIOD_S)[:, None]
    slow, fast = np.sin(2 * np.pi * 0.5 * time_s), 0.1 * np.sin(2 * np.pi * 40.0 * time_s)
    middle = slice(200, -200)
    np.testing.assert_allclose(zero_phase(slow + fast, 5.0, PERIOD_S)[middle], slow[middle], atol=2e-3)


def test_the_filter_keeps_a_command_that_is_at_rest_at_both_ends() -> None:
    desired = swing().position_rad
    filtered = zero_phase(desired, 5.0, PERIOD_S)
    assert filtered.shape == desired.shape
    np.testing.assert_allclose(filtered[[0, -1]], desired[[0, -1]], atol=1e-3)
