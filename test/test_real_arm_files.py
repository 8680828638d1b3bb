"""The files that bring up a real arm fit together, and what does not fit is refused before anything starts.

ros2_control cannot be run here: that its parameters exist and mean what they should has been looked up in its
sources (see the comments in config/ros2_control/controllers.yaml).
"""

from __future__ import annotations

import dataclasses
import importlib.util
import re
import shutil
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest
import yaml

from tel_ros.app.bring_up import node_names
from tel_ros.app.practice import check_before_moving
from tel_ros.core.config import Config
from tel_ros.core.errors import ConfigError, InputFileError
from tel_ros.recording import topics
from tel_ros.recording.config_file import load_config

ROOT = Path(__file__).parents[1]
CONFIG = ROOT / "config" / "real_arm.yaml"
CONTROLLERS = ROOT / "config" / "ros2_control" / "controllers.yaml"
POSITION_CONTROLLERS = CONTROLLERS.with_name("controllers_position.yaml")
TRAJECTORY_CONTROLLERS = CONTROLLERS.with_name("controllers_trajectory.yaml")


@pytest.fixture(scope="module")
def launch_file() -> ModuleType:
    spec = importlib.util.spec_from_file_location("real_arm_launch", ROOT / "launch" / "real_arm.launch.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def config() -> Config:
    return load_config(CONFIG)


def changed(tmp_path: Path, node: str, original: Path = CONTROLLERS, **values: Any) -> Path:
    """Return a copy of the controllers' parameters with other values; None removes one."""
    parameters = yaml.safe_load(original.read_text())
    for key, value in values.items():
        parameters[node]["ros__parameters"].pop(key)
        if value is not None:
            parameters[node]["ros__parameters"][key] = value
    file = tmp_path / "controllers.yaml"
    file.write_text(yaml.safe_dump(parameters))
    return file


def test_the_pattern_is_for_an_external_arm_and_within_its_limits(config: Config) -> None:
    assert config.run.arm == "external"
    assert "sim_bridge" not in node_names(config)
    check_before_moving(config)


def test_the_pattern_begins_with_limits_below_those_of_the_urdf(config: Config) -> None:
    urdf = Path(config.arm.urdf).read_text()
    limits = re.findall(r'<limit lower="(.*?)" upper="(.*?)" effort="(.*?)" velocity="(.*?)"/>', urdf)
    assert len(limits) == len(config.arm.joints)
    for k, (lower, upper, effort, velocity) in enumerate(limits):
        assert float(lower) < config.arm.position_min_rad[k] < config.arm.position_max_rad[k] < float(upper)
        assert config.arm.effort_limit_nm[k] < float(effort)
        assert config.arm.velocity_limit_rad_s[k] < float(velocity)


def test_the_controllers_fit_the_pattern_and_publish_where_the_nodes_listen(
    launch_file: ModuleType, config: Config
) -> None:
    launch_file.check_controllers(CONTROLLERS, config)
    parameters = yaml.safe_load(CONTROLLERS.read_text())
    manager = parameters["controller_manager"]["ros__parameters"]
    broadcaster = parameters["joint_state_broadcaster"]["ros__parameters"]
    assert manager["joint_state_broadcaster"]["type"] == "joint_state_broadcaster/JointStateBroadcaster"
    assert manager["effort_controller"]["type"] == "effort_controllers/JointGroupEffortController"
    assert topics.EFFORT_COMMANDS == "effort_controller/commands"
    assert topics.JOINT_STATES == "joint_states" and broadcaster["use_local_topics"] is False


@pytest.fixture(scope="module")
def position_config() -> Config:
    return load_config(CONFIG, ["arm.command_interface=position"])


def test_the_controllers_for_positions_fit_the_pattern_and_hear_where_set_points_are_sent(
    launch_file: ModuleType, position_config: Config
) -> None:
    launch_file.check_controllers(POSITION_CONTROLLERS, position_config)
    parameters = yaml.safe_load(POSITION_CONTROLLERS.read_text())
    manager = parameters["controller_manager"]["ros__parameters"]
    assert manager["position_controller"]["type"] == "forward_command_controller/ForwardCommandController"
    assert topics.POSITION_COMMANDS == "position_controller/commands"


JTC = "joint_trajectory_controller"


@pytest.mark.parametrize(
    ("node", "values", "complaint"),
    [
        ("effort_controller", {"joints": ["elbow", "shoulder"]}, r"in that order"),
        ("effort_controller", {"joints": ["shoulder"]}, r"expected \['shoulder', 'elbow'\], as arm.joints"),
        ("effort_controller", {"joints": None}, r"joints is 'missing'"),
        ("controller_manager", {"update_rate": 100}, r"is 100; expected 500.0, as control.rate_hz"),
        ("controller_manager", {"update_rate": None}, r"update_rate is 'missing'"),
        ("position_controller", {"joints": ["elbow", "shoulder"]}, r"in that order"),
        ("position_controller", {"interface_name": "effort"}, r"'position', as arm.command_interface"),
        ("controller_manager", {"enforce_command_limits": True}, r"set points are not positions"),
        ("controller_manager", {"enforce_command_limits": None}, r"enforce_command_limits is 'missing'"),
        (JTC, {"command_interfaces": ["position"]}, r"is \['position'\]; expected \['effort'\], since traj"),
        (JTC, {"state_interfaces": ["position"]}, r"for springs and dampers"),
        (JTC, {"gains": {"shoulder": {"p": 15.0, "d": 1.5}}}, r"gains.shoulder.i is 'missing'; expected 0.0"),
        (JTC, {"gains": {"shoulder": {"p": 150.0}}}, r"p is 150.0; expected 15.0, as arm.stiffness"),
        (JTC, {"gains": None}, r"gains.shoulder.p is 'missing'"),
    ],
)
def test_controllers_for_another_arm_or_with_another_law_are_refused(
    launch_file: ModuleType, tmp_path: Path, node: str, values: dict[str, Any], complaint: str
) -> None:
    kind = {"position_controller": "position", JTC: "trajectory"}.get(node, "effort")
    kind = "position" if "enforce_command_limits" in values else kind
    original = CONTROLLERS.with_name(launch_file.PATTERNS[kind])
    file = changed(tmp_path, node, original, **values)
    with pytest.raises(ConfigError, match=complaint) as error:
        launch_file.check_controllers(file, load_config(CONFIG, [f"arm.command_interface={kind}"]))
    assert str(file) in str(error.value)


def test_controllers_for_the_other_interface_are_refused(
    launch_file: ModuleType, config: Config, position_config: Config
) -> None:
    with pytest.raises(ConfigError, match=r"position_controller.*joints is 'missing'"):
        launch_file.check_controllers(CONTROLLERS, position_config)
    with pytest.raises(ConfigError, match=r"effort_controller.*joints is 'missing'"):
        launch_file.check_controllers(POSITION_CONTROLLERS, config)


def test_a_description_has_to_offer_the_interface_that_is_commanded(
    launch_file: ModuleType, position_config: Config, tmp_path: Path
) -> None:
    efforts = Path(position_config.arm.urdf)
    with pytest.raises(InputFileError, match="no command_interface 'position' for joint 'shoulder'"):
        launch_file.check_description(efforts, position_config)
    file = tmp_path / "arm.urdf"
    text = efforts.read_text()
    effort, position = (f'<command_interface name="{name}"/>' for name in ("effort", "position"))
    assert text.count(effort) == 2
    file.write_text(text.replace(effort, position))
    launch_file.check_description(file, position_config)


@pytest.fixture(scope="module")
def trajectory_config() -> Config:
    return load_config(CONFIG, ["arm.command_interface=trajectory"])


def test_the_trajectory_controller_has_the_law_of_practice_and_hears_where_goals_are_sent(
    launch_file: ModuleType, trajectory_config: Config, tmp_path: Path
) -> None:
    launch_file.check_controllers(TRAJECTORY_CONTROLLERS, trajectory_config)
    launch_file.check_description(Path(trajectory_config.arm.urdf), trajectory_config)
    text = Path(trajectory_config.arm.urdf).read_text()
    (tmp_path / "arm.urdf").write_text(
        text.replace('<state_interface name="velocity">', '<state_interface name="speed">')
    )
    with pytest.raises(InputFileError, match="no state_interface 'velocity' for joint 'shoulder'"):
        launch_file.check_description(tmp_path / "arm.urdf", trajectory_config)
    parameters = yaml.safe_load(TRAJECTORY_CONTROLLERS.read_text())
    manager = parameters["controller_manager"]["ros__parameters"]
    kind = manager[trajectory_config.arm.trajectory_controller]["type"]
    assert kind == "joint_trajectory_controller/JointTrajectoryController"
    faster = dataclasses.replace(trajectory_config.arm, controller_rate_hz=1000.0)
    with pytest.raises(ConfigError, match=r"update_rate is 500; expected 1000.0, as arm.controller_rate_hz"):
        launch_file.check_controllers(
            TRAJECTORY_CONTROLLERS, dataclasses.replace(trajectory_config, arm=faster)
        )


@pytest.mark.parametrize("text", ["effort_controller: 3", "{}"])
def test_a_file_without_the_controllers_is_refused(
    launch_file: ModuleType, config: Config, tmp_path: Path, text: str
) -> None:
    file = tmp_path / "controllers.yaml"
    file.write_text(text)
    with pytest.raises(ConfigError, match="update_rate is 'missing'"):
        launch_file.check_controllers(file, config)


def with_urdf(config: Config, tmp_path: Path, old: str, new: str) -> tuple[Path, Config]:
    """Return a changed URDF of the pattern, and the configuration with it."""
    text = Path(config.arm.urdf).read_text()
    assert old in text
    file = tmp_path / "arm.urdf"
    file.write_text(text.replace(old, new, 1))
    return file, dataclasses.replace(config, arm=dataclasses.replace(config.arm, urdf=str(file)))


def test_the_description_of_the_pattern_has_all_interfaces(launch_file: ModuleType, config: Config) -> None:
    launch_file.check_description(Path(config.arm.urdf), config)


@pytest.mark.parametrize(
    ("old", "new", "complaint"),
    [
        ('<command_interface name="effort"/>', "", r"no command_interface 'effort' for joint 'shoulder'"),
        ('<state_interface name="position">', '<state_interface name="angle">', r"no state_interface"),
        ('    <joint name="elbow">', '    <joint name="wrist">', r"'effort' for joint 'elbow'"),
        ("</robot>", "", r"not readable \(no element found"),
    ],
)
def test_a_description_that_ros2_control_could_not_use_is_refused(
    launch_file: ModuleType, config: Config, tmp_path: Path, old: str, new: str, complaint: str
) -> None:
    file, other = with_urdf(config, tmp_path, old, new)
    with pytest.raises(InputFileError, match=complaint):
        launch_file.check_description(file, other)


def test_a_description_of_an_arm_that_is_only_simulated_is_refused(
    launch_file: ModuleType, config: Config
) -> None:
    simulated = Path(load_config(ROOT / "config" / "planar_arm.yaml").arm.urdf)
    with pytest.raises(InputFileError, match="<ros2_control> has no command_interface 'effort'"):
        launch_file.check_description(simulated, config)


class Started:
    """What the launch file would start, looked at without starting anything.

    Args:
        module: the launch file.
        arguments: of ``ros2 launch``.
    """

    def __init__(self, module: ModuleType, **arguments: str) -> None:
        # `launch` alone would be found: the folder of that name here.
        pytest.importorskip("launch_ros.actions", reason="needs ROS's launch")
        launch = pytest.importorskip("launch")
        self.context = launch.LaunchContext()
        self.context.launch_configurations.update(arguments)
        self.failures: list[str] = []
        loop = SimpleNamespace(call_exception_handler=lambda about: self.failures.append(about["message"]))
        self.context._set_asyncio_loop(loop)
        *declared, group = module.generate_launch_description().entities
        for argument in declared:
            argument.execute(self.context)
        (function,) = (e for e in group.get_sub_entities() if type(e).__name__ == "OpaqueFunction")
        self.actions = function.execute(self.context)
        self.next = self.actions

    def executables(self) -> list[str]:
        """Return the executables that the actions of this step start, in order."""
        return [action.node_executable for action in self.next if type(action).__name__ == "Node"]

    def end(self, executable: str, code: int) -> None:
        """Go on as if the last process with this executable had ended."""
        (ended,) = [a for a in self.next if getattr(a, "node_executable", None) == executable]
        on_exit = ended._ExecuteLocal__on_exit  # launch has no other way to ask for it
        event = type("ProcessExited", (), {"returncode": code})()
        self.next = on_exit(event, self.context)


NODES = ["inverse_dynamics", "trial_recorder", "arm_guard", "ep_controller", "practice_manager"]


def test_driver_first_then_one_controller_after_the_other_then_the_nodes(launch_file: ModuleType) -> None:
    started = Started(launch_file)
    assert started.executables() == ["robot_state_publisher", "ros2_control_node", "spawner"]
    started.end("spawner", 0)
    assert started.executables() == ["spawner"]
    started.end("spawner", 0)
    assert started.executables() == NODES


@pytest.mark.parametrize("good", [0, 1])
def test_a_controller_that_cannot_be_started_ends_everything(launch_file: ModuleType, good: int) -> None:
    started = Started(launch_file)
    for _ in range(good):
        started.end("spawner", 0)
    started.end("spawner", 1)
    name = ["joint_state_broadcaster", "effort_controller"][good]
    assert started.failures == [f"{name} could not be started"]
    ended = {type(action.event).__name__ for action in started.next}
    assert ended == {"ShutdownProcess"} and len(started.next) == 3 + good


def test_the_driver_alone_and_the_nodes_alone(launch_file: ModuleType) -> None:
    driver = Started(launch_file, start="driver")
    driver.end("spawner", 0)
    driver.end("spawner", 0)
    assert driver.executables() == []
    assert Started(launch_file, start="nodes").executables() == NODES


def test_practice_can_be_started_at_once(launch_file: ModuleType, tmp_path: Path) -> None:
    started = Started(launch_file, start="nodes", run_dir=str(tmp_path / "run"))
    command = "".join(part.perform(started.context) for words in started.next[-1].cmd for part in words)
    assert str(tmp_path / "run") in command and "/practice" in command


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        ({"config": str(ROOT / "config" / "planar_arm.yaml")}, "run.arm is 'sim'; expected 'external'"),
        ({"commands": "inactive"}, "commands is 'inactive'; expected 'active', because start is 'all'"),
        ({"start": "driver", "run_dir": "bags/x"}, "run_dir is 'bags/x'; expected nothing"),
    ],
)
def test_arguments_that_do_not_go_together_are_refused(
    launch_file: ModuleType, arguments: dict[str, str], complaint: str
) -> None:
    with pytest.raises(ConfigError, match=complaint):
        Started(launch_file, **arguments)


def test_nothing_starts_when_the_controllers_are_for_another_arm(
    launch_file: ModuleType, tmp_path: Path
) -> None:
    file = changed(tmp_path, "effort_controller", joints=["elbow", "shoulder"])
    with pytest.raises(ConfigError, match="in that order"):
        Started(launch_file, controllers=str(file))


def test_an_inactive_effort_controller_is_asked_for_by_the_option_of_the_spawner(
    launch_file: ModuleType, tmp_path: Path
) -> None:
    started = Started(launch_file, start="driver", commands="inactive")
    started.end("spawner", 0)
    assert "--inactive" in [str(a) for a in started.next[0]._Node__arguments]


def test_the_pattern_can_be_copied_elsewhere(tmp_path: Path) -> None:
    shutil.copytree(ROOT / "config", tmp_path / "config")
    copied = load_config(tmp_path / "config" / "real_arm.yaml")
    assert Path(copied.arm.urdf).is_relative_to(tmp_path)
