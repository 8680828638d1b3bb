"""The URDF of an arm whose configuration names no file: from the latched topic ``robot_description``."""

from __future__ import annotations

import atexit
import shutil
import tempfile
import time
from pathlib import Path
from typing import Any

from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from std_msgs.msg import String

from tel_ros.core.errors import TelError
from tel_ros.core.urdf import DECLARATION
from tel_ros.nodes import qos
from tel_ros.nodes.runner import start_ros
from tel_ros.recording import topics

TIMEOUT_S = 30.0
"""Nodes may start before the driver."""


def description_for(node: Node) -> Path:
    """Return a file with the robot description that a node would hear; TelError: none comes in time."""
    topic = node.resolve_topic_name(topics.ROBOT_DESCRIPTION)
    node.get_logger().info(f"arm.urdf is empty: waits for {topic}")
    return _heard(topic, node.context)


def description_in(namespace: str) -> Path:
    """Return a file with the robot description in a namespace; TelError: none comes in time."""
    context = Context()
    start_ros(context=context)
    try:
        return _heard(topics.absolute(topics.ROBOT_DESCRIPTION, namespace), context)
    finally:
        context.try_shutdown()


def _heard(topic: str, context: Context) -> Path:
    """Return a file that lasts as long as this process."""
    heard: list[Any] = []
    # A node of its own: the one that asks is not whole yet, and must not serve anybody.
    listener = Node("robot_description_listener", context=context, use_global_arguments=False)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(listener)
    listener.create_subscription(String, topic, heard.append, qos.LATCHED)
    try:
        end = time.monotonic() + TIMEOUT_S
        while not heard and time.monotonic() < end:
            executor.spin_once(timeout_sec=0.1)
    finally:
        executor.shutdown(timeout_sec=1.0)
        listener.destroy_node()
    if not heard:
        raise TelError(
            f"no robot description on {topic} within {TIMEOUT_S:g} s; expected a file in arm.urdf, "
            "or a driver or robot_state_publisher that runs in this namespace"
        )
    folder = Path(tempfile.mkdtemp(prefix="tel_ros_"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    file = folder / "robot_description.urdf"
    # What the text declares was true of the file that it came from.
    file.write_text(DECLARATION.sub(r"\1", heard[-1].data, count=1), encoding="utf-8")
    return file
