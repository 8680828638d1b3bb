"""``tel fastest``: what a URDF would allow, what a run has learned, and limits for planners."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import yaml
from click.testing import CliRunner, Result

import sim_bridge
from tel_lab.exact_model import ExactInverseDynamics
from tel_lab.offline import OfflinePractice
from tel_ros.app.cli import main
from tel_ros.app.fastest import by_urdf
from tel_ros.core.learning.inputs import stack_inputs
from tel_ros.core.practice.strategy import Movement, PlannedTrial
from tel_ros.recording.config_file import load_config
from tel_ros.recording.network_file import new_network, save_network
from tel_ros.recording.run_folder import NETWORK_FILE, create_run_folder
from tel_ros.recording.waypoint_file import load_path

CONFIG = Path(__file__).parents[2] / "config" / "planar_arm.yaml"
URDF = Path(sim_bridge.__file__).parent / "urdf" / "planar_arm.urdf"
pytest.importorskip("pinocchio")


def told(*arguments: str) -> Result:
    return CliRunner().invoke(main, ["fastest", *arguments])


def told_json(*arguments: str) -> dict[str, object]:
    result = told(*arguments, "--json")
    assert result.exit_code == 0, result.stderr
    return json.loads(result.stdout)


def test_the_urdf_of_the_simulated_arm_tells_what_its_exact_model_does() -> None:
    """Both compute rigid bodies, one with Pinocchio and one with PyBullet; dry friction is none here."""
    config = load_config(CONFIG, [])
    exact = ExactInverseDynamics(config, config.sim).predict
    states = np.random.default_rng(1).uniform(-1.0, 1.0, (50, 6)) * [2.0, 2.0, 5.0, 5.0, 30.0, 30.0]
    np.testing.assert_allclose(by_urdf(CONFIG, ()).offsets(states), exact(states), atol=1e-6)


def test_more_effort_makes_it_faster_and_minimum_jerk_takes_about_twice_as_long() -> None:
    found = told_json("planar_arm")
    at_90, at_100 = found["times"]
    assert (at_90["effort_share"], at_100["effort_share"]) == (0.9, 1.0)
    # Without bounds on the rates of efforts toppra finds 1.41 s for all of the effort.
    assert 1.41 < at_100["time_optimal_s"] < at_90["time_optimal_s"] < 1.41 / 0.9
    assert 1.8 < at_90["minimum_jerk_s"] / at_90["time_optimal_s"] < 2.2
    shoulder, elbow = found["joints"]
    assert shoulder["at_its_effort"] > 0.5 > elbow["at_its_effort"]


def test_values_of_the_configuration_can_be_changed() -> None:
    half = told_json("planar_arm", "--set", "practice.effort_share=0.5")
    assert half["times"][0]["effort_share"] == 0.5
    assert half["times"][0]["time_optimal_s"] > 1.3 * half["times"][1]["time_optimal_s"]


@pytest.fixture(scope="module")
def run_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a run on an arm twice as heavy as its URDF says, with the network of two trials."""
    config = load_config(CONFIG, ["learning.name=rigid_body", "sim.inertia_scale=2"])
    folder = tmp_path_factory.mktemp("runs") / "heavy"
    create_run_folder(folder, config)
    with OfflinePractice(config, load_path(config.path, config.arm), new_network(config)) as practice:
        for index, duration_s in enumerate((9.0, 5.0), start=1):
            practice.run_trial(PlannedTrial(index, 1.0, Movement(duration_s)))
        save_network(practice.learner, folder / NETWORK_FILE)
    return folder


def test_a_run_tells_what_was_learned_there_and_not_what_the_urdf_says(run_folder: Path) -> None:
    """Twice the inertia takes the root of two times as long."""
    learned, described = (
        told_json(each)["times"][0]["time_optimal_s"] for each in (str(run_folder), "planar_arm")
    )
    assert learned / described == pytest.approx(np.sqrt(2.0), rel=0.03)


def test_limits_for_moveit_keep_efforts_within_theirs(tmp_path: Path) -> None:
    file = tmp_path / "joint_limits.yaml"
    result = told("planar_arm", "--joint-limits", str(file))
    assert result.exit_code == 0 and str(file) in result.stdout.replace("\n", "")
    limits = yaml.safe_load(file.read_text())["joint_limits"]
    assert list(limits) == ["shoulder", "elbow"]
    assert all(limit["has_velocity_limits"] and limit["has_acceleration_limits"] for limit in limits.values())
    most = [limits[j][key] for key in ("max_velocity", "max_acceleration") for j in limits]
    found, random = by_urdf(CONFIG, ()), np.random.default_rng(3)
    q, _, _ = load_path(found.config.path, found.config.arm).evaluate(random.uniform(size=4000))
    v, a = np.split(random.choice([-1.0, 1.0], (4000, 4)) * most, 2, axis=1)
    share = np.abs(found.efforts(stack_inputs(q, v, a))) / np.array(found.config.arm.effort_limit_nm)
    assert 0.6 < share.max() < 0.9 * 1.01
    again = told("planar_arm", "--joint-limits", str(file))
    assert again.exit_code == 2 and "exists already" in again.stderr


def test_a_urdf_without_inertias_is_refused_in_one_line(tmp_path: Path) -> None:
    robot, bare = ElementTree.parse(URDF), tmp_path / "bare.urdf"
    for link in robot.iter("link"):
        for inertial in link.findall("inertial"):
            link.remove(inertial)
    robot.write(bare)
    result = told("planar_arm", "--set", f"arm.urdf={bare}", "--set", "run.arm=external")
    assert result.exit_code == 2
    assert (
        "bare.urdf: joint 'shoulder' moves neither mass nor inertia; expected an <inertial>" in result.stderr
    )
    assert result.stderr.startswith("tel: ") and result.stderr.count("\n") == 1


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["nowhere.yaml"], "nowhere.yaml"),
        (["planar_arm", "--set", "practice.effort_share=2"], "practice.effort_share is 2"),
        (["planar_arm", "--joint-limits", "/proc/nowhere/limits.yaml"], "/proc/nowhere/limits.yaml"),
    ],
)
def test_wrong_input_ends_with_code_2_and_one_line(arguments: list[str], said: str) -> None:
    result = told(*arguments)
    assert result.exit_code == 2
    assert said in result.stderr
    assert result.stderr.startswith("tel: ") and result.stderr.count("\n") == 1


def test_a_run_has_its_own_values(run_folder: Path) -> None:
    result = told(str(run_folder), "--set", "seed=3")
    assert result.exit_code == 2 and "--set is 'seed=3'" in result.stderr


def test_a_run_without_a_network_is_refused(run_folder: Path, tmp_path: Path) -> None:
    folder = tmp_path / "new"
    create_run_folder(folder, replace(load_config(CONFIG, []), seed=1))
    result = told(str(folder))
    assert result.exit_code == 2 and "network.npz" in result.stderr
