"""Holding a practice run between two trials, for as long as somebody asks for it."""

from __future__ import annotations

import threading
from collections.abc import Callable

from rclpy.callback_groups import CallbackGroup
from rclpy.node import Node
from std_msgs.msg import Bool
from std_srvs.srv import SetBool

from tel_ros.nodes import qos
from tel_ros.recording import topics

_LOOK_PERIOD_S = 0.1


class Pause:
    """Whether the next trial has to wait; a trial that is under way is none of its business.

    It lasts until it is taken back, over the end of a run as well: whoever has said "not now" and turned away
    must not find the arm moving.

    Args:
        node: of the practice run.
        group: of callbacks that are served while a run waits.
    """

    def __init__(self, node: Node, group: CallbackGroup) -> None:
        self._node = node
        self._go_on = threading.Event()
        self._go_on.set()
        self._paused_pub = node.create_publisher(Bool, topics.PAUSED, qos.LATCHED)
        self._paused_pub.publish(Bool(data=False))
        node.create_service(SetBool, topics.PAUSE, self._ask, callback_group=group)

    @property
    def asked(self) -> bool:
        """Whether a run has to wait before its next trial."""
        return not self._go_on.is_set()

    def wait(self, given_up: Callable[[], bool]) -> None:
        """Wait until the pause is taken back, or the run that waits is given up."""
        while not given_up() and not self._go_on.wait(_LOOK_PERIOD_S):
            pass

    def _ask(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        if request.data:
            self._go_on.clear()
        else:
            self._go_on.set()
        self._paused_pub.publish(Bool(data=request.data))
        response.success = True
        response.message = "the next trial waits" if request.data else "the run goes on"
        self._node.get_logger().info(response.message)
        return response
