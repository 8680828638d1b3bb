"""What the learners reach on the default arm, in whole practice runs without ROS."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tel_lab.offline import OfflinePractice
from tel_ros.recording.config_file import load_config
from tel_ros.recording.network_file import new_network
from tel_ros.recording.waypoint_file import load_path

CONFIG = Path(__file__).parents[2] / "config" / "planar_arm.yaml"
SCHEDULE = (
    *("practice.strategy=trajectory_extension", "practice.trials=4"),
    *("practice.first_duration_s=6.0", "practice.goal_duration_s=4.5", "sim.physics_rate_hz=1000"),
)
"""The last four steps of the paper's schedule."""
LONGER = ("practice.trials=7", "practice.first_duration_s=7.5")
NOISE_AND_DELAY = ("sim.position_noise_rad=1e-4", "sim.command_delay_s=2e-3")
pytestmark = pytest.mark.timeout(120)


def rms_mrad(*overrides: str, change: Callable[[OfflinePractice, int], None] | None = None) -> np.ndarray:
    """Return the RMS error of each trial of a practice run."""
    config = load_config(CONFIG, [*SCHEDULE, *overrides])
    with OfflinePractice(config, load_path(config.path, config.arm), new_network(config)) as practice:
        before = (lambda plan: change(practice, plan.index)) if change else (lambda plan: None)
        done = practice.run(before_trial=before)
    return np.array([1e3 * trial.trial.report.rms_error_rad for trial in done])


@pytest.mark.parametrize(
    ("noise", "from_third", "final"),
    [((), 5.0, 4.0), (NOISE_AND_DELAY, 10.0, 10.0)],
    ids=["16-bit encoder", "noise and delay"],
)
def test_solved_trees_keep_the_error_small_up_to_goal_speed(
    noise: tuple[str, ...], from_third: float, final: float
) -> None:
    error = rms_mrad(*LONGER, *noise)
    assert len(error) == 7
    assert error[2:].max() <= from_third
    assert error[-1] <= final


@pytest.mark.parametrize(
    ("noise", "most"), [((), 2.0), (NOISE_AND_DELAY, 4.0)], ids=["16-bit encoder", "noise and delay"]
)
def test_rigid_links_with_trees_need_one_trial(noise: tuple[str, ...], most: float) -> None:
    pytest.importorskip("pinocchio")
    error = rms_mrad("learning.name=rigid_body+lms_tree", *noise)
    assert len(error) == 4
    assert error[1:].max() <= most


def test_after_a_payload_was_put_on_three_trials_are_enough() -> None:
    def put_on(practice: OfflinePractice, trial: int) -> None:
        if trial == 3:
            sim = load_config(CONFIG, ["sim.coulomb_friction_nm=[0.3,0.3]"]).sim
            practice.arm.replace_arm(replace(sim, payload_kg=0.5))

    error = rms_mrad("sim.coulomb_friction_nm=[0.3,0.3]", *LONGER, change=put_on)
    assert error[2] > 40.0  # else the payload was no change
    assert error[5:].max() <= 10.0
