"""Starts the node graph of a practice run, one process a node.

ros2 launch tel_ros practice.launch.py                              the graph alone, paper's protocol
ros2 launch tel_ros practice.launch.py config:=planar_arm           another shipped run, or a file of yours
ros2 launch tel_ros practice.launch.py run_dir:=bags/monday         and practise: the run goes to that folder
ros2 launch tel_ros practice.launch.py namespace:=left              beside another arm

Without run_dir, practice starts when somebody asks for it:
ros2 action send_goal --feedback /practice tel_interfaces/action/Practice "{run_dir: /home/me/bags/monday}"

The return code is 1 if the run or a node failed.
"""

from functools import partial
from pathlib import Path

from launch import LaunchContext, LaunchDescription
from launch.actions import GroupAction, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import PushRosNamespace

from tel_ros.app.launch_graph import LaunchGraph, arguments, is_installed
from tel_ros.nodes.robot_description import description_in
from tel_ros.recording.config_file import load_config
from tel_ros.recording.shared_files import named_config


def start_graph(context: LaunchContext) -> list:
    """Return one action for each node that the configuration needs."""
    config_file = named_config(LaunchConfiguration("config").perform(context)).resolve()
    graph = LaunchGraph(context)
    config = load_config(config_file, description=partial(description_in, graph.namespace))
    # robot_description and TF of the simulated arm; a driver brings its own.
    described = config.run.arm == "sim" and is_installed("robot_state_publisher")
    return [
        *([graph.robot_state_publisher(Path(config.arm.urdf))] if described else []),
        *graph.practice(config, config_file),
    ]


def generate_launch_description() -> LaunchDescription:
    """Return the description of the graph."""
    start = [PushRosNamespace(LaunchConfiguration("namespace")), OpaqueFunction(function=start_graph)]
    return LaunchDescription([*arguments("paper", "the practice run"), GroupAction(start)])
