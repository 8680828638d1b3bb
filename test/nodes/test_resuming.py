"""A controller that has gone through recorded trials holds what it held after them."""

from __future__ import annotations

import shutil
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "sim_bridge"))

from recorded_run import record_run  # noqa: E402

from tel_ros.core.arm_state import ArmState  # noqa: E402
from tel_ros.core.control.controller import EpController  # noqa: E402
from tel_ros.core.errors import BagError  # noqa: E402
from tel_ros.nodes.controller_services import replay_control  # noqa: E402
from tel_ros.nodes.conversions import to_goal  # noqa: E402
from tel_ros.recording import topics  # noqa: E402
from tel_ros.recording.config_file import load_config  # noqa: E402
from tel_ros.recording.resumption import resumed_config  # noqa: E402
from tel_ros.recording.run_folder import CONFIG_FILE, trial_bag  # noqa: E402
from tel_ros.recording.trial_bag import read_topic, read_trial  # noqa: E402

PAPER = Path(__file__).parents[2] / "config" / "paper.yaml"
SHORT = (
    *("practice.trials=2", "practice.first_duration_s=4.0", "practice.goal_duration_s=3.0"),
    *("control.approach_speed_rad_s=1.5", "learning.gaussians_per_input=5"),
    *("control.rate_hz=250", "sim.physics_rate_hz=1000"),
)


@pytest.fixture(scope="module", params=["effort", "position"])
def whole(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of two trials. Tests only look at it: making it takes seconds."""
    folder = tmp_path_factory.mktemp("runs") / request.param
    record_run(folder, load_config(PAPER, [*SHORT, f"arm.command_interface={request.param}"]))
    return folder


@pytest.fixture
def after_one(whole: Path, tmp_path: Path) -> Path:
    """The same run, killed in its second trial."""
    (tmp_path / "run").mkdir()
    for name in (CONFIG_FILE, "planar_arm.urdf"):
        shutil.copy(whole / name, tmp_path / "run")
    shutil.copytree(trial_bag(whole, 1), trial_bag(tmp_path / "run", 1))
    return tmp_path / "run"


def test_the_next_trial_goes_on_from_what_was_held(whole: Path, after_one: Path) -> None:
    config = resumed_config(after_one)
    controller = EpController(config.arm, config.control, config.safety)
    assert replay_control(controller, after_one, config.arm.joints)
    bag = trial_bag(whole, 2)
    ((_, goal),) = read_topic(bag, topics.TRIAL_GOAL)
    controller.start(to_goal(goal, config.arm.joints))
    trial = read_trial(bag)
    for k, time_ns in enumerate(trial.time_ns.tolist()):
        tick = controller.tick(ArmState(time_ns, trial.position_rad[k], trial.velocity_rad_s[k]))
        assert tick is not None
        np.testing.assert_array_equal(tick.effort_nm, trial.effort_nm[k])
        np.testing.assert_array_equal(tick.equilibrium_rad, trial.equilibrium_rad[k])
    assert controller.report is not None


def test_a_controller_that_decides_otherwise_is_told(after_one: Path) -> None:
    config = resumed_config(after_one)
    slower = replace(config.control, approach_speed_rad_s=1.0)
    assert not replay_control(EpController(config.arm, slower, config.safety), after_one, config.arm.joints)


def test_trials_of_other_joints_are_refused(after_one: Path) -> None:
    config = resumed_config(after_one)
    with pytest.raises(BagError, match="is of the joints shoulder, elbow; expected elbow, shoulder"):
        replay_control(EpController(config.arm, config.control), after_one, ("elbow", "shoulder"))
