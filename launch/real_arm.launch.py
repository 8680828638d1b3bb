"""Brings up a real arm on stock ros2_control, and the nodes that practise on it.

ros2 launch tel_ros real_arm.launch.py config:=my_run.yaml controllers:=my_controllers.yaml start:=driver
    the driver alone, for `tel practice` in another terminal: the way to begin (docs/real-arm.md)
... start:=driver commands:=inactive    no command reaches the motors; joint states can be looked at
... start:=nodes                        the nodes of tel_ros alone, for a driver that runs already
... run_dir:=bags/monday                driver, nodes and practice; the run goes to that folder
... namespace:=left                     everything in a namespace, beside another arm

The driver is the controller manager with the hardware component that the URDF names, joint_state_broadcaster
and, as arm.command_interface says, effort_controller, an effort_controllers/JointGroupEffortController,
position_controller, a forward_command_controller/ForwardCommandController, or what arm.trajectory_controller
names, a joint_trajectory_controller/JointTrajectoryController. Names of packages, executables, arguments and
topics are those of ros2_control for Jazzy:
https://control.ros.org/jazzy/doc/ros2_control/controller_manager/doc/userdoc.html
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree

from tel_ros.core.config import Config
from tel_ros.core.errors import ConfigError, InputFileError
from tel_ros.recording import topics
from tel_ros.recording.config_file import load_config, read_yaml
from tel_ros.recording.shared_files import config_folder, named_config

if TYPE_CHECKING:
    from launch import LaunchContext, LaunchDescription

BROADCASTER = "joint_state_broadcaster"
PATTERNS = {
    "effort": "controllers.yaml",
    "position": "controllers_position.yaml",
    "trajectory": "controllers_trajectory.yaml",
}
"""Files in config/ros2_control."""
STATES = {"effort": ["position"], "position": ["position"], "trajectory": ["position", "velocity"]}
"""Which state interfaces the hardware has to have."""


def controller_name(config: Config) -> str:
    """Return the name of the controller of the commands, below which it listens to them."""
    return topics.commands(config.arm).rpartition("/")[0]


def check_controllers(file: Path, config: Config, namespace: str = "/") -> None:
    """Make sure that the controllers are set up for this arm.

    The command is an array without names: joints in another order would get each other's commands.

    Args:
        file: parameters of the controller manager and the two controllers.
        config: the practice run.
        namespace: of the arm; keys of the file may name it, or stand for any (``/**/effort_controller``).

    Raises:
        InputFileError: the file is missing or unreadable.
        ConfigError: a parameter is missing or does not fit the practice run.
    """
    parameters = read_yaml(file)

    def require(node: str, key: str, expected: Any, why: str) -> None:
        names = (f"{namespace.rstrip('/')}/{node}", f"/**/{node}", *([node] if namespace == "/" else []))
        section = next((parameters[name] for name in names if name in parameters), None)
        values = section.get("ros__parameters") if isinstance(section, dict) else None
        for part in key.split("."):
            values = values.get(part, "missing") if isinstance(values, dict) else "missing"
        found = values
        if found != expected:
            raise ConfigError(f"{node}.ros__parameters.{key}", found, f"{expected!r}, {why}", str(file))

    arm, controller = config.arm, controller_name(config)
    rate = "arm.controller_rate_hz" if arm.controller_rate_hz else "control.rate_hz"
    rate_hz = arm.controller_rate_hz or config.control.rate_hz
    require("controller_manager", "update_rate", rate_hz, f"as {rate}")
    require(controller, "joints", list(arm.joints), "as arm.joints, in that order")
    if arm.command_interface == "trajectory":
        require(controller, "command_interfaces", ["effort"], "since trajectories bring efforts")
        require(controller, "state_interfaces", ["position", "velocity"], "for springs and dampers")
        for joint, p, d in zip(arm.joints, arm.stiffness_nm_per_rad, arm.damping_nms_per_rad, strict=True):
            require(controller, f"gains.{joint}.p", p, "as arm.stiffness_nm_per_rad")
            require(controller, f"gains.{joint}.d", d, "as arm.damping_nms_per_rad")
            for other in ("i", "ff_velocity_scale"):
                require(controller, f"gains.{joint}.{other}", 0.0, "or the law is not that of practice")
    if arm.command_interface == "position":
        require(controller, "interface_name", "position", "as arm.command_interface")
        # It would change set points, and nobody would learn of it.
        require("controller_manager", "enforce_command_limits", False, "since set points are not positions")


def check_description(file: Path, config: Config) -> None:
    """Make sure that a URDF tells ros2_control of the interfaces that the arm's joints need.

    The controller manager would wait for a driver without end, or fail at the activation of a controller.

    Args:
        file: the URDF.
        config: the practice run.

    Raises:
        InputFileError: it cannot be read, has no <ros2_control> element, or an interface is missing there.
    """
    try:
        root = ElementTree.parse(file).getroot()
    except (ElementTree.ParseError, OSError) as error:
        raise InputFileError(file, f"not readable ({error})", "a URDF file (key arm.urdf)") from None
    joints = {joint.get("name"): joint for joint in root.findall("ros2_control/joint")}
    interface = config.arm.command_interface
    command = "effort" if interface == "trajectory" else interface
    needed = [("command_interface", command), *(("state_interface", state) for state in STATES[interface])]
    for name in config.arm.joints:
        for kind, interface in needed:
            joint = joints.get(name)
            if joint is None or not any(found.get("name") == interface for found in joint.findall(kind)):
                raise InputFileError(
                    file,
                    f"its <ros2_control> has no {kind} {interface!r} for joint {name!r}",
                    "one for each joint of the arm, or start:=nodes if another driver runs",
                )


def check_arm(config: Config, file: Path) -> None:
    """Make sure that the run is one for a real arm.

    Raises:
        ConfigError: it is not.
    """
    if config.run.arm != "external":
        raise ConfigError("run.arm", config.run.arm, "'external': nothing is simulated here", str(file))


def start_arm(context: LaunchContext) -> list[Any]:
    """Return the actions that bring up what was asked for."""
    from launch.actions import LogInfo

    from tel_ros.app.launch_graph import LaunchGraph
    from tel_ros.nodes.robot_description import description_in

    def argument(name: str) -> str:
        return str(context.launch_configurations[name])

    graph, start, commands = LaunchGraph(context), argument("start"), argument("commands")
    config_file = named_config(argument("config")).resolve()
    # The driver that is started here needs the file; one that runs already has published it.
    heard = partial(description_in, graph.namespace) if start == "nodes" else None
    config = load_config(config_file, description=heard)
    check_arm(config, config_file)
    controller = controller_name(config)
    if commands == "inactive" and start != "driver":
        raise ConfigError("commands", commands, f"'active', because start is {start!r}")
    if argument("run_dir") and start == "driver":
        raise ConfigError("run_dir", argument("run_dir"), "nothing, because start is 'driver'")
    if start == "nodes":
        return list(graph.practice(config, config_file))
    pattern = config_folder() / "ros2_control" / PATTERNS[config.arm.command_interface]
    controllers = Path(argument("controllers") or pattern).resolve()
    check_controllers(controllers, config, graph.namespace)
    check_description(Path(config.arm.urdf), config)
    options = ["--param-file", str(controllers)]
    options += ["--controller-manager-timeout", str(config.run.arm_timeout_s)]

    def spawner(name: str, more: list[str], then: Any) -> Any:
        """Return the process that loads, configures and activates a controller, and then ends."""
        on_exit = graph.then(name, then)
        return graph.node(
            "controller_manager", "spawner", [], arguments=[name, *options, *more], on_exit=on_exit
        )

    def spawn_controller() -> list[Any]:
        return [spawner(controller, ["--inactive"] if commands == "inactive" else [], driver_is_up)]

    def driver_is_up() -> list[Any]:
        said = LogInfo(msg=f"the driver is up, {controller} is {commands}")
        return [said, *(graph.practice(config, config_file) if start == "all" else [])]

    # One after the other: no controller is started for an arm whose state cannot be read.
    return [
        graph.robot_state_publisher(Path(config.arm.urdf)),  # from which the controller manager has the URDF
        graph.node("controller_manager", "ros2_control_node", [str(controllers)]),
        spawner(BROADCASTER, [], spawn_controller),
    ]


def generate_launch_description() -> LaunchDescription:
    """Return the description of the driver and the graph."""
    # Imported where it is used: the checks above need no launch, and are tested without.
    from launch import LaunchDescription
    from launch.actions import DeclareLaunchArgument, GroupAction, OpaqueFunction
    from launch.substitutions import LaunchConfiguration
    from launch_ros.actions import PushRosNamespace

    from tel_ros.app.launch_graph import arguments

    return LaunchDescription(
        [
            *arguments("real_arm", "the practice run, with run.arm external"),
            DeclareLaunchArgument(
                "controllers",
                default_value="",
                description="parameters of the controller manager and its controllers; empty: the pattern",
            ),
            DeclareLaunchArgument(
                "start",
                default_value="all",
                choices=["all", "driver", "nodes"],
                description="what to start: the driver (ros2_control), the nodes of tel_ros, or both",
            ),
            DeclareLaunchArgument(
                "commands",
                default_value="active",
                choices=["active", "inactive"],
                description="state of the controller of commands; inactive: none reaches the motors",
            ),
            GroupAction(
                [PushRosNamespace(LaunchConfiguration("namespace")), OpaqueFunction(function=start_arm)]
            ),
        ]
    )
