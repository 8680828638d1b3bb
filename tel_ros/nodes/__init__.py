"""ROS nodes: each turns messages into arrays, asks the core, and turns the answer into messages."""
