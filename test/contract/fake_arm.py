"""The faulty arm behind the topics of a real one, without sim_bridge: ``fake_arm.py RATE_HZ FAULT``."""

from __future__ import annotations

import sys
import time
from pathlib import Path

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

sys.path.insert(0, str(Path(__file__).parent))

from faulty_arm import FaultyArm  # noqa: E402

PATIENT_WATCHDOG_S = 0.08
"""On a busy machine commands come less regularly than a short one asks for."""

NODE_FAULTS = ("wrong_name_second_commander", "nobody_listens", "repeats_when_pushed")


class FakeArm(Node):
    """Publishes what :class:`FaultyArm` reports, stamped with the time of day."""

    def __init__(self, rate_hz: float, fault: str) -> None:
        super().__init__("fake_arm")
        self._node_fault = fault if fault in NODE_FAULTS else ""
        self._arm = FaultyArm("" if self._node_fault else fault, 1.0 / rate_hz, watchdog_s=PATIENT_WATCHDOG_S)
        self._last: JointState | None = None
        self._states = self.create_publisher(JointState, "/joint_states", 10)
        if self._node_fault != "nobody_listens":
            self.create_subscription(Float64MultiArray, "/effort_controller/commands", self._on_command, 10)
        if "second_commander" in self._node_fault:
            self.create_publisher(Float64MultiArray, "/effort_controller/commands", 10)
        # In the middle between two turns of the timer: at their edge a little jitter would make it none and
        # two periods in turn.
        self._start_s = time.time() + 0.5 / rate_hz
        self.create_timer(1.0 / rate_hz, self._pass_period)

    def _on_command(self, message: Float64MultiArray) -> None:
        if len(message.data) == 2 and all(abs(value) < 1e6 for value in message.data):
            self._arm.command(list(message.data))

    def _pass_period(self) -> None:
        # A busy machine may skip periods; the arm does not.
        reading = None
        while self._start_s + self._arm.time_s < time.time():
            reading = self._arm.step()
        if reading is None:
            return
        stamp_s = self._start_s + reading.stamp_s
        message = JointState(name=["elbow", "finger", "shoulder"])
        if "wrong_name" in self._node_fault:
            message.name = ["ellbogen", "finger", "shoulder"]
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(round(stamp_s * 1e9), 10**9)
        # Other names in another order, as a broadcaster may have them.
        message.position = [reading.position[1], 0.7, reading.position[0]]
        message.velocity = [reading.velocity[1], 0.0, reading.velocity[0]]
        message.effort = [reading.effort[1], 0.0, reading.effort[0]] if reading.effort else []
        if self._last is not None and self._node_fault == "repeats_when_pushed" and any(self._last.effort):
            message = self._last
        self._last = message
        self._states.publish(message)


def main() -> None:
    rclpy.init()
    try:
        rclpy.spin(FakeArm(float(sys.argv[1]), sys.argv[2]))
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
