"""Arms whose drives take equilibrium points: what they do with them, and that they can be practised on."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from sim_bridge.arm import CommandError, PositionDrive, SimulatedArm
from tel_lab.offline import OfflineArm, OfflinePractice
from tel_ros.core.practice.session import PractisedTrial
from tel_ros.core.trajectories.trajectory import sample
from tel_ros.core.trial import Outcome, Phase, Trial, TrialGoal
from tel_ros.core.types import NS_PER_S
from tel_ros.recording.config_file import load_config
from tel_ros.recording.network_file import new_network
from tel_ros.recording.waypoint_file import load_path

CONFIG = Path(__file__).parents[2] / "config"
POSITION = {"command_interface": "position"}
MakeArm = Callable[..., SimulatedArm]


def practised(name: str, *overrides: str) -> list[PractisedTrial[Trial]]:
    """Return two trials, the second one faster, that a rigid-body learner has practised."""
    config = load_config(
        CONFIG / f"{name}.yaml",
        [
            *(*overrides, "practice.strategy=trajectory_extension", "learning.name=rigid_body"),
            *("control.rate_hz=250", "sim.physics_rate_hz=2000"),
        ],
    )
    with OfflinePractice(config, load_path(config.path, config.arm), new_network(config)) as practice:
        return practice.run()


def test_a_drive_is_a_spring_and_a_damper_of_limited_strength() -> None:
    drive = PositionDrive((10.0, 20.0), (1.0, 2.0), (3.0, 3.0))
    assert drive.effort_nm((0.2, 0.1), (0.1, 0.0), (0.5, -0.25)) == pytest.approx((0.5, 2.5))
    assert drive.effort_nm((9.0, -9.0), (0.0, 0.0), (0.0, 0.0)) == (3.0, -3.0)


def test_an_arm_goes_to_its_set_point_and_stays_there_in_silence(make_arm: MakeArm) -> None:
    arm = make_arm(arm=POSITION)
    goal = np.array(arm.reading().position_rad) + [0.2, -0.1]
    arm.step(goal)
    for _ in range(5000):
        arm.coast()
    assert arm.true_position_rad == pytest.approx(goal, abs=1e-4)


def test_before_its_first_command_an_arm_holds_the_posture_that_it_starts_in(make_arm: MakeArm) -> None:
    """Zero would be another posture, on the way of a command as well."""
    start = (0.7, -0.9)
    arm = make_arm(arm=POSITION, initial_position_rad=start, command_delay_s=0.01)
    arm.coast()
    for _ in range(5):
        arm.step((0.8, -0.9))
        assert arm.reading().effort_nm == (0.0, 0.0)
    arm.step((0.8, -0.9))
    assert arm.reading().effort_nm[0] == pytest.approx(1.5, rel=0.1)


def test_the_drive_answers_the_motion_within_a_control_period(make_arm: MakeArm) -> None:
    """With a control period of 50 ms an effort that stayed constant for so long would fling the arm about."""
    arm = make_arm(arm={**POSITION, "damping_nms_per_rad": (6.0, 3.0)}, rate_hz=20.0, encoder_bits=0)
    goal = np.array(arm.reading().position_rad) + 0.3
    for _ in range(100):
        arm.step(goal)
    assert arm.true_position_rad == pytest.approx(goal, abs=1e-3)


def test_a_far_set_point_gets_no_more_than_the_effort_limit(make_arm: MakeArm) -> None:
    arm = make_arm(arm={**POSITION, "effort_limit_nm": (4.0, 3.0)})
    arm.step((50.0, -50.0))
    assert arm.reading().effort_nm == (4.0, -3.0)


@pytest.mark.parametrize("command", [(float("nan"), 0.0), (0.0,), (0.0, float("inf"))])
def test_a_set_point_that_cannot_be_used_is_refused_and_nothing_passes(
    make_arm: MakeArm, command: tuple[float, ...]
) -> None:
    arm = make_arm(arm=POSITION)
    with pytest.raises(CommandError, match="expected 2 finite numbers of rad"):
        arm.step(command)
    assert arm.time_ns == 0


@pytest.mark.parametrize("scale", [0.5, 2.0])
def test_practice_learns_drives_whatever_their_stiffness_really_is(scale: float) -> None:
    """What is learned is which equilibrium point leads to which movement; K is not needed for that."""
    first, second = practised(
        "planar_arm",
        *("arm.command_interface=position", f"sim.drive_stiffness_scale={scale}"),
        *("practice.durations_s=[6.0, 4.5]", "practice.goal_duration_s=4.5"),
    )
    assert first.trial.report.rms_error_rad > 0.05
    assert np.max(second.trial.report.rms_error_per_joint_rad) < 3e-3
    for trial in (first.trial, second.trial):
        assert trial.report.outcome == Outcome.COMPLETED
        assert not trial.saturated.any()


def test_an_arm_under_gravity_is_learned_through_its_drives() -> None:
    first, second = practised(
        "kuka_iiwa",
        *("arm.command_interface=position", "practice.durations_s=[3.0, 2.0]"),
        "practice.goal_duration_s=2.0",
    )
    assert first.trial.report.rms_error_rad > 0.03
    assert np.max(second.trial.report.rms_error_per_joint_rad) < 3e-3
    assert not second.trial.saturated.any()


def test_a_trial_beyond_its_path_tolerance_is_braked_through_set_points_that_do_not_jump() -> None:
    config = load_config(
        CONFIG / "planar_arm.yaml", ["arm.command_interface=position", "control.path_tolerance_rad=0.15"]
    )
    desired = sample(load_path(config.path, config.arm), 4.5, config.control.rate_hz)
    with OfflineArm(config) as arm:
        trial = arm.run_trial(TrialGoal(1, 1.0, desired, desired.position_rad))
        assert arm.plant.at_rest(0.05)
    assert trial.report.outcome == Outcome.ABORTED
    assert "path tolerance 0.150 rad" in trial.report.message
    speed = np.abs(np.diff(trial.equilibrium_rad, axis=0)) * NS_PER_S / np.diff(trial.time_ns)[:, None]
    assert np.all(speed <= np.array(config.arm.velocity_limit_rad_s) * (1.0 + 1e-9))
    stop = trial.phase == Phase.STOP
    # The arm does not get far, and what it reaches is held.
    assert np.abs(trial.position_rad[stop] - trial.position_rad[stop][0]).max() < 0.5
    assert np.abs(trial.equilibrium_rad[-1] - trial.position_rad[-1]).max() < 0.05
