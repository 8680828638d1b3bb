"""Starts the node graph of a practice run, one process a node.

ros2 launch tel_ros practice.launch.py                              the graph alone, paper's protocol
ros2 launch tel_ros practice.launch.py config:=/path/to/my.yaml     another run
ros2 launch tel_ros practice.launch.py run_dir:=bags/monday         and practise: the run goes to that folder

Without run_dir, practice starts when somebody asks for it:
ros2 action send_goal --feedback /practice tel_interfaces/action/Practice "{run_dir: bags/monday}"
"""

from pathlib import Path

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess, OpaqueFunction, Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from tel_ros.app.bring_up import node_names
from tel_ros.recording.config_file import default_config_file, load_config
from tel_ros.recording.shared_files import named_config


def start_graph(context: LaunchContext) -> list:
    """Return one action for each node that the configuration needs."""
    config_file = named_config(LaunchConfiguration("config").perform(context)).resolve()
    run_dir = LaunchConfiguration("run_dir").perform(context)
    actions = [
        Node(
            package="tel_ros",
            executable=name,
            name=name,
            output="screen",
            parameters=[{"config": str(config_file)}],
            # Without any one of them the others have nothing to do; the controller brings the arm to rest.
            on_exit=Shutdown(reason=f"{name} has ended"),
        )
        for name in node_names(load_config(config_file))
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
    """Return the description of the graph."""
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "config",
                default_value=str(default_config_file()),
                description="YAML file of the practice run",
            ),
            DeclareLaunchArgument(
                "run_dir", default_value="", description="new folder for the run; empty: wait for /practice"
            ),
            OpaqueFunction(function=start_graph),
        ]
    )
