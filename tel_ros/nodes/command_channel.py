"""Where commands go to, and what letting go means there."""

from __future__ import annotations

import numpy as np
from rclpy.node import Node
from std_msgs.msg import Float64MultiArray

from tel_ros.core.config import ArmConfig
from tel_ros.core.control.records import Tick
from tel_ros.nodes import qos
from tel_ros.nodes.conversions import EffortCommand
from tel_ros.recording import topics


class CommandChannel:
    """The commands of a controller to the arm.

    With the effort interface an arm is let go by zero effort. With the position interface it must not be
    sent anything then: zeros are a posture, and the drive holds the last set point by itself.

    Args:
        node: gets the publisher.
        arm: its command interface and number of joints.
    """

    def __init__(self, node: Node, arm: ArmConfig) -> None:
        self._interface = arm.command_interface
        self._n_joints = len(arm.joints)
        self._message = EffortCommand(self._n_joints)
        self.topic = topics.COMMANDS[self._interface]
        self._pub = node.create_publisher(Float64MultiArray, self.topic, qos.STREAM)
        self.let_go_text = (
            "zero effort" if self._interface == "effort" else "the drive holds its last set point"
        )
        """What :meth:`let_go` leads to, in words."""

    @property
    def is_heard(self) -> bool:
        """Whether somebody listens to the commands."""
        return bool(self._pub.get_subscription_count() > 0)

    def send(self, stamp_ns: int, tick: Tick) -> None:
        """Answer the state with this stamp."""
        self._pub.publish(self._message.fill(stamp_ns, tick.command(self._interface)))

    def repeat(self) -> None:
        """Send the last command again."""
        self._pub.publish(self._message.message)

    def let_go(self, stamp_ns: int) -> None:
        """Leave the arm to itself, or to its drive."""
        if self._interface == "effort":
            self._pub.publish(self._message.fill(stamp_ns, np.zeros(self._n_joints)))
