"""Health of a node on ``/diagnostics``: once a second, and at once when it changes.

``diagnostic_updater`` does this elsewhere; it is not to be had as a wheel, so the messages are made here.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import Enum

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.callback_groups import CallbackGroup
from rclpy.node import Node

from tel_ros.nodes import qos
from tel_ros.nodes.clock import STEADY
from tel_ros.recording import topics

PERIOD_S = 1.0


class Level(Enum):
    """How bad it is; numbers as in ``DiagnosticStatus``."""

    OK = DiagnosticStatus.OK
    WARN = DiagnosticStatus.WARN
    ERROR = DiagnosticStatus.ERROR


@dataclass(frozen=True)
class Health:
    """How a node is: level and message for a person, values for whoever wants to know more."""

    level: Level
    message: str
    values: Mapping[str, object] = field(default_factory=dict)


class Diagnostics:
    """Publishes a node's health under the name ``node: task``, with the namespace in front.

    A robot monitor groups by ``hardware``, the name of the arm. ``health`` is asked ten times a second; a
    change of level or message is published at once.
    """

    def __init__(
        self,
        node: Node,
        task: str,
        hardware: str,
        health: Callable[[], Health],
        group: CallbackGroup | None = None,
    ) -> None:
        self._node, self._health, self._hardware = node, health, hardware
        self._name = f"{node.get_fully_qualified_name().removeprefix('/')}: {task}"
        self._pub = node.create_publisher(DiagnosticArray, topics.DIAGNOSTICS, qos.EVENTS)
        self._said: tuple[Level, str] | None = None
        self._next_at = 0.0
        node.create_timer(0.1, self._look, callback_group=group, clock=STEADY)

    def _look(self) -> None:
        health = self._health()
        if time.monotonic() >= self._next_at or (health.level, health.message) != self._said:
            self._publish(health)

    def publish(self) -> None:
        """Publish now; for a node that is about to be busy for long."""
        self._publish(self._health())

    def _publish(self, health: Health) -> None:
        self._said, self._next_at = (health.level, health.message), time.monotonic() + PERIOD_S
        status = DiagnosticStatus(
            level=health.level.value,
            name=self._name,
            message=health.message,
            hardware_id=self._hardware,
            values=[KeyValue(key=key, value=str(value)) for key, value in health.values.items()],
        )
        array = DiagnosticArray(status=[status])
        array.header.stamp = self._node.get_clock().now().to_msg()
        self._pub.publish(array)


class RateMeter:
    """Counts what arrives, and says how often a second; counting is all that happens where it is busy."""

    def __init__(self) -> None:
        self.count = 0
        self._last_count, self._last_at, self._rate_hz = 0, time.monotonic(), 0.0

    def rate_hz(self) -> float:
        """Return the rate over the last second or so (wall clock)."""
        elapsed_s = time.monotonic() - self._last_at
        if elapsed_s >= PERIOD_S:
            self._rate_hz = (self.count - self._last_count) / elapsed_s
            self._last_count, self._last_at = self.count, time.monotonic()
        return self._rate_hz
