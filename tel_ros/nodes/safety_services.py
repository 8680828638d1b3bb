"""The emergency stop in software: two services and a latched topic."""

from __future__ import annotations

from collections.abc import Callable

from rclpy.node import Node
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from tel_ros.nodes import qos
from tel_ros.recording import topics


class SafetyServices:
    """Latches a stop until it is reset.

    Args:
        node: that commands the arm.
        stop: stops it, for the reason given.
        why_not_reset: tells why a reset has to wait; empty: it need not.
        reset: allows trials again.
    """

    def __init__(
        self,
        node: Node,
        stop: Callable[[str], None],
        why_not_reset: Callable[[], str],
        reset: Callable[[], None],
    ) -> None:
        self._node, self._stop_arm, self._why_not_reset, self._reset_arm = node, stop, why_not_reset, reset
        self.reason = ""
        """Why the stop is latched; empty: it is not."""
        self._stopped_pub = node.create_publisher(Bool, topics.SAFETY_STOPPED, qos.LATCHED)
        self._tell()
        self.stop_name = node.create_service(Trigger, topics.SAFETY_STOP, self._stop).service_name
        self.reset_name = node.create_service(Trigger, topics.SAFETY_RESET, self._reset).service_name
        """Full names of the services."""

    def _tell(self) -> None:
        self._stopped_pub.publish(Bool(data=bool(self.reason)))

    def _stop(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self.reason = f"emergency stop ({self.stop_name})"
        self._stop_arm(self.reason)  # also if it is latched already: asking twice is asking to stop
        self._tell()
        self._node.get_logger().error(f"{self.reason}: latched until {self.reset_name}")
        response.success, response.message = True, f"stopped until {self.reset_name}"
        return response

    def _reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        why_not = self._why_not_reset() if self.reason else "no stop is latched"
        if why_not:
            response.message = f"not reset: {why_not}"
            self._node.get_logger().warning(response.message)
            return response
        self.reason = ""
        self._reset_arm()
        self._tell()
        response.success, response.message = True, "reset: trials are accepted again"
        self._node.get_logger().info(response.message)
        return response
