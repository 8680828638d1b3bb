"""Brings up a real arm on stock ros2_control, and the nodes that practise on it.

ros2 launch tel_ros real_arm.launch.py config:=my_run.yaml controllers:=my_controllers.yaml start:=driver
    the driver alone, for `tel practice` in another terminal: the way to begin (docs/real-arm.md)
... start:=driver commands:=inactive    no command reaches the motors; joint states can be looked at
... start:=nodes                        the nodes of tel_ros alone, for a driver that runs already
... run_dir:=bags/monday                driver, nodes and practice; the run goes to that folder

The driver is the controller manager with the hardware component that the URDF names, joint_state_broadcaster
and, as arm.command_interface says, effort_controller, an effort_controllers/JointGroupEffortController,
or position_controller, a forward_command_controller/ForwardCommandController. Names of packages, executables,
arguments and topics are those of ros2_control for Jazzy:
https://control.ros.org/jazzy/doc/ros2_control/controller_manager/doc/userdoc.html
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree

from tel_ros.app.bring_up import node_names
from tel_ros.core.config import Config
from tel_ros.core.errors import ConfigError, InputFileError
from tel_ros.recording.config_file import default_config_file, load_config, read_yaml
from tel_ros.recording.shared_files import named_config

if TYPE_CHECKING:
    from launch import LaunchContext, LaunchDescription
    from launch.events.process import ProcessExited

BROADCASTER = "joint_state_broadcaster"
CONTROLLERS = {"effort": "effort_controller", "position": "position_controller"}
"""Name of the controller for each command interface; with it, the topic is that of docs/architecture.md."""
PATTERNS = {"effort": "controllers.yaml", "position": "controllers_position.yaml"}
"""Files in config/ros2_control."""


def check_controllers(file: Path, config: Config) -> None:
    """Make sure that the controllers are set up for this arm.

    The command is an array without names: joints in another order would get each other's commands.

    Args:
        file: parameters of the controller manager and the two controllers.
        config: the practice run.

    Raises:
        InputFileError: the file is missing or unreadable.
        ConfigError: a parameter is missing or does not fit the practice run.
    """
    parameters = read_yaml(file)

    def require(node: str, key: str, expected: Any, why: str) -> None:
        section = parameters.get(node)
        values = section.get("ros__parameters") if isinstance(section, dict) else None
        found = values.get(key, "missing") if isinstance(values, dict) else "missing"
        if found != expected:
            raise ConfigError(f"{node}.ros__parameters.{key}", found, f"{expected!r}, {why}", str(file))

    require("controller_manager", "update_rate", config.control.rate_hz, "as control.rate_hz")
    controller = CONTROLLERS[config.arm.command_interface]
    require(controller, "joints", list(config.arm.joints), "as arm.joints, in that order")
    if config.arm.command_interface == "position":
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
    for name in config.arm.joints:
        for kind, interface in (
            ("command_interface", config.arm.command_interface),
            ("state_interface", "position"),
        ):
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
    from launch.actions import EmitEvent, LogInfo
    from launch.events import Shutdown

    def argument(name: str) -> str:
        return str(context.launch_configurations[name])

    config_file = named_config(argument("config")).resolve()
    config = load_config(config_file)
    check_arm(config, config_file)
    pattern = default_config_file().parent / "ros2_control" / PATTERNS[config.arm.command_interface]
    controllers = Path(argument("controllers") or pattern).resolve()
    controller = CONTROLLERS[config.arm.command_interface]
    start, commands, run_dir = argument("start"), argument("commands"), argument("run_dir")
    if commands == "inactive" and start != "driver":
        raise ConfigError("commands", commands, f"'active', because start is {start!r}")
    if run_dir and start == "driver":
        raise ConfigError("run_dir", run_dir, "nothing, because start is 'driver'")
    if start == "nodes":
        return _nodes(config, config_file, run_dir)
    check_controllers(controllers, config)
    check_description(Path(config.arm.urdf), config)

    def after(name: str, actions: list[Any]) -> Callable[[ProcessExited, LaunchContext], list[Any]]:
        """Return what to do when the spawner of a controller has ended."""

        def go_on(event: ProcessExited, context: LaunchContext) -> list[Any]:
            if event.returncode == 0:
                return actions
            return [EmitEvent(event=Shutdown(reason=f"{name} could not be started"))]

        return go_on

    last = _nodes(config, config_file, run_dir) if start == "all" else []
    last.insert(0, LogInfo(msg=f"the driver is up, {controller} is {commands}"))
    options = [
        "--param-file",
        str(controllers),
        "--controller-manager-timeout",
        str(config.run.arm_timeout_s),
    ]
    passive = ["--inactive"] if commands == "inactive" else []
    spawn_controller = _spawner(controller, [*options, *passive], after(controller, last))
    # One after the other: no controller is started for an arm whose state cannot be read.
    spawn_broadcaster = _spawner(BROADCASTER, options, after(BROADCASTER, [spawn_controller]))
    return [*_controller_manager(config, controllers), spawn_broadcaster]


def _controller_manager(config: Config, controllers: Path) -> list[Any]:
    """Return the controller manager, and robot_state_publisher, from which it gets the URDF."""
    from launch.actions import Shutdown
    from launch_ros.actions import Node
    from launch_ros.parameter_descriptions import ParameterValue

    urdf = ParameterValue(Path(config.arm.urdf).read_text(encoding="utf-8"), value_type=str)
    return [
        Node(
            package="robot_state_publisher",
            executable="robot_state_publisher",
            output="screen",
            parameters=[{"robot_description": urdf}],
        ),
        Node(
            package="controller_manager",
            executable="ros2_control_node",
            output="screen",
            parameters=[str(controllers)],
            on_exit=Shutdown(reason="the controller manager has ended"),
        ),
    ]


def _spawner(name: str, options: list[str], on_exit: Callable[..., Any]) -> Any:
    """Return the process that loads, configures and activates a controller, and then ends."""
    from launch_ros.actions import Node

    return Node(
        package="controller_manager",
        executable="spawner",
        arguments=[name, *options],
        output="screen",
        on_exit=on_exit,
    )


def _nodes(config: Config, config_file: Path, run_dir: str) -> list[Any]:
    """Return the nodes of tel_ros, and the command to practise if there is a folder for the run."""
    from launch.actions import ExecuteProcess, Shutdown
    from launch_ros.actions import Node

    actions: list[Any] = [
        Node(
            package="tel_ros",
            executable=name,
            name=name,
            output="screen",
            parameters=[{"config": str(config_file)}],
            # Without any one of them the others have nothing to do; the driver's end takes the effort away.
            on_exit=Shutdown(reason=f"{name} has ended"),
        )
        for name in node_names(config)
    ]
    if run_dir:
        goal = f'{{run_dir: "{Path(run_dir).resolve()}"}}'
        actions.append(
            ExecuteProcess(
                cmd=["ros2", "action", "send_goal", "/practice", "tel_interfaces/action/Practice", goal],
                output="screen",
                on_exit=Shutdown(reason="practice is over"),
            )
        )
    return actions


def generate_launch_description() -> LaunchDescription:
    """Return the description of the driver and the graph."""
    # Imported where it is used: the checks above need no launch, and are tested without.
    from launch import LaunchDescription
    from launch.actions import DeclareLaunchArgument, OpaqueFunction

    folder = default_config_file().parent
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "config",
                default_value=str(folder / "real_arm.yaml"),
                description="YAML file of the practice run; its run.arm is external",
            ),
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
            DeclareLaunchArgument(
                "run_dir", default_value="", description="new folder for the run; empty: wait for /practice"
            ),
            OpaqueFunction(function=start_arm),
        ]
    )
