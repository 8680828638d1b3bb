"""The steady clock, which nobody can stop, and a watch over ROS time, which somebody has to publish."""

from __future__ import annotations

import time

from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from tel_ros.recording import topics

STEADY = Clock(clock_type=ClockType.STEADY_TIME)
"""Of all timers: with ``use_sim_time`` a node's own clock stands still as long as nobody publishes time."""
WATCH_S = 0.022
"""From one look for silence to the next, at the most: a silent loop serves its timers every 20 ms."""
MISSING_S = 3.0
LOOK_PERIOD_S = 0.5


def longest_silence_s(timeout_s: float) -> float:
    """Return after which silence a watchdog has to act: at its next look the time-out might be over."""
    return timeout_s - min(WATCH_S, 0.5 * timeout_s)


class ClockWatch:
    """Says in the log when ROS time, by which a node is to go, stands still, and when it goes on."""

    def __init__(self, node: Node) -> None:
        self._node, self._now_ns, self._since, self._missed = node, -1, time.monotonic(), False
        if node.get_parameter("use_sim_time").value:
            node.create_timer(LOOK_PERIOD_S, self._look, clock=STEADY)

    def _look(self) -> None:
        now_ns, log = self._node.get_clock().now().nanoseconds, self._node.get_logger()
        if now_ns != self._now_ns and now_ns:
            self._now_ns, self._since = now_ns, time.monotonic()
            if self._missed:
                log.info(f"the time on {topics.CLOCK} goes on")
            self._missed = False
        elif not self._missed and time.monotonic() - self._since > MISSING_S:
            self._missed = True
            found = self._node.count_publishers(topics.CLOCK)
            why = f"the time on {topics.CLOCK} stands still" if found else f"nobody publishes {topics.CLOCK}"
            log.warning(f"use_sim_time is true and {why}: watchdogs go by the clock of the machine")
