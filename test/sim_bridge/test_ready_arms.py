"""The configurations that come with the project can be practised: joints found, gravity met, limits kept."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tel_lab.offline import OfflinePractice
from tel_ros.core.trial import Outcome, Phase
from tel_ros.recording.config_file import load_config
from tel_ros.recording.network_file import new_network
from tel_ros.recording.waypoint_file import load_path

CONFIG = Path(__file__).parents[2] / "config"


@pytest.mark.parametrize(
    ("name", "durations_s", "sags_rad"),
    [("planar_arm_3", [6.0, 4.5], 0.0), ("kuka_iiwa", [3.0, 2.0], 0.05), ("franka_panda", [7.0, 5.0], 0.05)],
)
def test_what_one_slow_trial_teaches_about_rigid_links_serves_at_a_higher_speed(
    name: str, durations_s: list[float], sags_rad: float
) -> None:
    """3 mrad a joint is what is asked for at the goal speed; without learning it is 50 mrad and more.

    An arm under gravity sags until its springs carry it, which is what the first trial has to show.
    """
    overrides = ["practice.strategy=trajectory_extension", f"practice.durations_s={durations_s}"]
    config = load_config(
        CONFIG / f"{name}.yaml",
        [*overrides, "learning.name=rigid_body", f"practice.goal_duration_s={durations_s[-1]}"],
    )
    with OfflinePractice(config, load_path(config.path, config.arm), new_network(config)) as practice:
        first, second = practice.run()
    settled = np.flatnonzero(first.trial.phase == Phase.SETTLE)[-1]
    sag_rad = first.trial.position_rad[settled] - first.trial.desired[settled, : len(config.arm.joints)]
    assert np.abs(sag_rad).max() >= sags_rad
    assert first.trial.report.rms_error_rad > 0.03
    assert np.max(second.trial.report.rms_error_per_joint_rad) < 3e-3
    for trial in (first.trial, second.trial):
        assert trial.report.outcome == Outcome.COMPLETED
        assert not trial.saturated.any()
