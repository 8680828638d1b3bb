"""What the launch files share: their arguments, and nodes that end together.

Nothing here shuts a launch down, since it may be part of a larger one: when a node or the run ends, the other
processes of the graph get SIGINT, and a launch with nothing else in it ends by itself. What failed makes its
return code 1. Imported by launch files alone: ``launch`` is part of a ROS installation, not of the wheels.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from ament_index_python.packages import PackageNotFoundError, get_package_prefix
from launch import LaunchContext, SomeEntitiesType
from launch.actions import DeclareLaunchArgument, EmitEvent, ExecuteProcess, LogInfo
from launch.events import matches_action
from launch.events.process import ProcessExited, ShutdownProcess
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from tel_ros.app.bring_up import node_names
from tel_ros.core.config import Config
from tel_ros.core.errors import ConfigError, TelError
from tel_ros.recording import topics
from tel_ros.recording.run_folder import read_summary
from tel_ros.recording.urdf import read_urdf


def arguments(config: str, about_config: str) -> list[DeclareLaunchArgument]:
    """Return the arguments that both launch files take."""
    described = {
        "config": (config, f"{about_config}: a YAML file, or the name of a shipped one (tel configs)"),
        "run_dir": ("", "new folder for the run, from where you are; empty: wait for the action practice"),
        "namespace": ("", "ROS namespace of the arm and of all nodes"),
        "log_level": ("info", "of all nodes"),
        "params_file": ("", "YAML file of ROS parameters for the nodes; they win over config"),
        "use_sim_time": ("false", "whether the nodes go by /clock instead of the time of the machine"),
    }
    return [
        DeclareLaunchArgument(
            name,
            default_value=default,
            description=about,
            choices=["false", "true"] if name == "use_sim_time" else None,
        )
        for name, (default, about) in described.items()
    ]


def is_installed(package: str) -> bool:
    """Return whether a ROS package is there."""
    try:
        get_package_prefix(package)
    except PackageNotFoundError:
        return False
    return True


class LaunchGraph:
    """The processes of one graph; ``context`` is inside the group that has pushed the namespace."""

    def __init__(self, context: LaunchContext) -> None:
        configurations = context.launch_configurations
        self.namespace = str(configurations.get("ros_namespace") or "/")
        self._log_level = str(configurations["log_level"])
        self._params_file = str(configurations["params_file"])
        self._sim_time = configurations["use_sim_time"] == "true"
        self._run_dir = str(configurations["run_dir"])
        self._started: list[ExecuteProcess] = []
        self._ending = False
        if self._run_dir and Path(self._run_dir).exists():
            raise ConfigError("run_dir", self._run_dir, "a folder that does not exist yet")

    def node(self, package: str, executable: str, parameters: list[Any], **more: Any) -> Node:
        """Return the action that starts a node of any package; the graph ends with it."""
        more.setdefault("on_exit", self._node_ended)
        # The group is over when a later step starts: the namespace is given in full.
        node = Node(
            package=package,
            executable=executable,
            namespace=self.namespace,
            output="screen",
            parameters=[*parameters, {"use_sim_time": self._sim_time}],
            ros_arguments=["--log-level", self._log_level],
            **more,
        )
        self._started.append(node)
        return node

    def robot_state_publisher(self, urdf: Path) -> Node:
        """Return the action that publishes robot_description and TF, with the namespace before the frames."""
        text = ParameterValue(read_urdf(urdf).text, value_type=str)
        prefix = "" if self.namespace == "/" else f"{self.namespace.strip('/')}/"
        parameters = [{"robot_description": text, "frame_prefix": prefix}]
        return self.node("robot_state_publisher", "robot_state_publisher", parameters)

    def practice(self, config: Config, config_file: Path) -> list[ExecuteProcess]:
        """Return the actions that start our nodes, and the one that asks for a run, if any."""
        given: list[Any] = [{"config": str(config_file)}, *filter(None, [self._params_file])]
        # Without a simulator of somebody else's, nobody else publishes the time that the nodes are to go by.
        clock = [{"sim.publish_clock": True}] if self._sim_time else []
        actions: list[ExecuteProcess] = [
            self.node("tel_ros", name, [*given, *(clock if name == "sim_bridge" else [])], name=name)
            for name in node_names(config)
        ]
        if self._run_dir:
            goal = f'{{run_dir: "{Path(self._run_dir).resolve()}"}}'
            name = topics.absolute(topics.PRACTICE, self.namespace)
            ask = ["ros2", "action", "send_goal", name, "tel_interfaces/action/Practice", goal]
            actions.append(ExecuteProcess(cmd=ask, output="screen", on_exit=self._run_ended))
            self._started.append(actions[-1])
        return actions

    def then(self, name: str, actions: Callable[[], list[Any]]) -> Callable[..., SomeEntitiesType]:
        """Return what is to happen when a process of one step has ended: the next step, if it succeeded."""

        def go_on(event: ProcessExited, context: LaunchContext) -> SomeEntitiesType:
            if event.returncode == 0:
                return [] if self._ending else actions()
            return self._end(context, f"{name} could not be started")

        return go_on

    def _node_ended(self, event: ProcessExited, context: LaunchContext) -> SomeEntitiesType:
        # Without any one of them the others have nothing to do; the controller brings the arm to rest.
        return self._end(context, f"{event.process_name} has ended with code {event.returncode}")

    def _run_ended(self, event: ProcessExited, context: LaunchContext) -> SomeEntitiesType:
        try:
            summary = read_summary(Path(self._run_dir))
            text = f"practice: {summary['outcome']}" + (summary["message"] and f": {summary['message']}")
            return self._end(context, text, failed=summary["outcome"] != "completed")
        except TelError as error:
            return self._end(context, f"practice has left no summary: {error}")

    def _end(self, context: LaunchContext, reason: str, failed: bool = True) -> SomeEntitiesType:
        """Return the actions that end all processes of the graph, and note a failure."""
        if self._ending or context.is_shutdown:
            return []
        self._ending = True
        if failed:
            # The one way to a return code that does not shut everything down; it logs the reason.
            context.asyncio_loop.call_exception_handler({"message": reason})
        signals = [
            EmitEvent(event=ShutdownProcess(process_matcher=matches_action(action)))
            for action in self._started
        ]
        return signals if failed else [LogInfo(msg=reason), *signals]
