"""ROS nodes: each turns messages into arrays, asks the core, and turns the answer into messages."""

from tel_ros.nodes.environment import exit_unless_usable

exit_unless_usable()
