"""A process in the place of a real arm, with the faults of one: ``python stand_in_arm.py FAULT SEED LOG``.

It shares nothing with the rest of this project, so that both cannot have the same thing wrong: two links in
formulas, integrated by Runge and Kutta's method, dry friction, stops, drives with a lag, a clock of its own,
and ros2_control's topics. At its end it writes what really was (LOG, .npz), on the monotonic clock.
"""

from __future__ import annotations

import itertools
import math
import random
import signal
import sys
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import rclpy
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

JOINTS = ("shoulder", "elbow")
URDF = """<robot name="stand_in"><link name="base"/><link name="upper"/><link name="hand"/>
<joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 0 1"/>
<limit lower="-2.6" upper="2.6" effort="20" velocity="12"/></joint>
<joint name="elbow" type="revolute"><parent link="upper"/><child link="hand"/><origin xyz="0.35 0 0"/>
<axis xyz="0 0 1"/><limit lower="-2.6" upper="2.6" effort="10" velocity="12"/></joint></robot>"""
"""Without inertias, as many are."""
EFFORT_LIMIT_NM = (20.0, 10.0)
RATE_HZ, STEPS = 500, 4
"""States a second; steps of the integration between them: the log has 2,000 rows a second."""
WATCHDOG_S, DRIVE_LAG_S, WEAK_NM, ENCODER_RAD = 0.1, 0.002, 1.0, 2.0 * math.pi / 2**17
STOP_RAD, STOP_NM_PER_RAD, STOP_NMS_PER_RAD = 2.6, 2000.0, 8.0
INERTIA_KGM2, COUPLING_KGM2 = (0.42, 0.075), 0.11
VISCOUS_NMS, DRY_NM = (0.08, 0.04), (0.15, 0.08)
MOVES_RAD_S = 0.5
FAULTS = ("none", "frozen", "silent", "same_stamp", "degrees", "flipped", "swapped", "weak")
"""Frozen, silent and same_stamp begin in motion, after SIGUSR1; the last four are there from the start."""


def acceleration(q: Any, v: Any, motor: Any) -> tuple[float, float]:
    """Return that of both joints in rad/s²: no gravity, links with their weight anywhere."""
    c, s = COUPLING_KGM2 * math.cos(q[1]), COUPLING_KGM2 * math.sin(q[1])
    torque = []
    for j in (0, 1):
        beyond = q[j] - max(-STOP_RAD, min(STOP_RAD, q[j]))
        wall = STOP_NM_PER_RAD * beyond + (STOP_NMS_PER_RAD * v[j] if beyond else 0.0)
        torque.append(motor[j] - VISCOUS_NMS[j] * v[j] - DRY_NM[j] * math.tanh(v[j] / 0.01) - wall)
    torque[0] += s * v[1] * (2.0 * v[0] + v[1])
    torque[1] -= s * v[0] * v[0]
    m00, m01, m11 = INERTIA_KGM2[0] + 2.0 * c, INERTIA_KGM2[1] + c, INERTIA_KGM2[1]
    det = m00 * m11 - m01 * m01
    return (m11 * torque[0] - m01 * torque[1]) / det, (m00 * torque[1] - m01 * torque[0]) / det


def stepped(x: tuple[float, ...], motor: Any, h: float) -> tuple[float, ...]:
    """Return (q, q, v, v) a step of h seconds later."""

    def slope(y: Any) -> tuple[float, ...]:
        return (y[2], y[3], *acceleration(y[:2], y[2:], motor))

    k1 = slope(x)
    k2 = slope([a + 0.5 * h * b for a, b in zip(x, k1, strict=True)])
    k3 = slope([a + 0.5 * h * b for a, b in zip(x, k2, strict=True)])
    k4 = slope([a + h * b for a, b in zip(x, k3, strict=True)])
    slopes = zip(x, k1, k2, k3, k4, strict=True)
    return tuple(a + h / 6.0 * (b + 2.0 * c + 2.0 * d + e) for a, b, c, d, e in slopes)


class StandIn:
    """The arm behind its topics; keeps what it did."""

    def __init__(self, fault: str, seed: int) -> None:
        chance = random.Random(seed)
        self._fault, self._delay_s = fault, chance.uniform(0.0, 0.4)
        self._x: tuple[float, ...] = (chance.uniform(0.0, 0.5), chance.uniform(0.0, 0.5), 0.0, 0.0)
        self._drift, self._motor, self._wanted = 1.0 + chance.uniform(-1e-4, 1e-4), [0.0, 0.0], [0.0, 0.0]
        self._commanded_s, self._armed, self._moving_s = 0.0, False, math.inf
        self.fault_s, self.rows, self.commands = (
            math.nan,
            list[tuple[float, ...]](),
            list[tuple[float, ...]](),
        )
        self._node = rclpy.create_node("stand_in_arm")
        self._states = self._node.create_publisher(JointState, "/joint_states", 10)
        self._node.create_subscription(Float64MultiArray, "/effort_controller/commands", self._on_command, 10)
        self._last = JointState(name=list(JOINTS))
        signal.signal(signal.SIGUSR1, self._arm)

    def _arm(self, *_: object) -> None:
        self._armed = True

    def _on_command(self, message: Float64MultiArray) -> None:
        self._commanded_s, self._wanted = time.monotonic(), list(message.data)
        label = message.layout.dim[0].label if message.layout.dim else ""
        self.commands.append((self._commanded_s, float(label if label.isdecimal() else "nan")))

    def run(self) -> None:
        """Keep the arm's time, which is its own clock's, beside the computer's."""
        print("ready", flush=True)
        begin_s, h = time.monotonic(), 1.0 / (RATE_HZ * STEPS)
        for k in itertools.count(1):
            until_s = begin_s + k / RATE_HZ * self._drift
            while (left_s := until_s - time.monotonic()) > 0.0:
                rclpy.spin_once(self._node, timeout_sec=left_s)
            for i in range(1 - STEPS, 1):
                self._step(until_s + i * h, h)
            self._publish(1000.0 + k / RATE_HZ)

    def _step(self, now_s: float, h: float) -> None:
        silent = now_s - self._commanded_s > WATCHDOG_S
        for j in (0, 1):
            most = WEAK_NM if self._fault == "weak" else EFFORT_LIMIT_NM[j]
            effort = 0.0 if silent else max(-most, min(most, self._wanted[j]))
            self._motor[j] += (effort - self._motor[j]) * h / DRIVE_LAG_S if effort else -self._motor[j]
        self._x = stepped(self._x, self._motor, h)
        self.rows.append((now_s, *self._x, *self._motor))

    def _publish(self, stamp_s: float) -> None:
        now_s = time.monotonic()
        if self._armed and self._moving_s == math.inf and max(map(abs, self._x[2:])) > MOVES_RAD_S:
            self._moving_s = now_s
        if math.isnan(self.fault_s) and now_s > self._moving_s + self._delay_s:
            self.fault_s = now_s
            print(now_s, flush=True)
        begun = not math.isnan(self.fault_s)
        if begun and self._fault == "silent":
            return
        message = self._last
        if not (begun and self._fault == "same_stamp"):
            message.header.stamp.sec, message.header.stamp.nanosec = divmod(round(stamp_s * 1e9), 10**9)
        if not (begun and self._fault == "frozen"):
            message.position, message.velocity = map(list, self._read())
        message.effort = list(self._motor)
        self._states.publish(message)

    def _read(self) -> Iterator[tuple[float, float]]:
        q, v = self._x[:2], self._x[2:]
        for a, b in (tuple(round(angle / ENCODER_RAD) * ENCODER_RAD for angle in q), v):
            miswired = {"degrees": (a, math.degrees(b)), "flipped": (a, -b), "swapped": (b, a)}
            yield miswired.get(self._fault, (a, b))


def main() -> None:
    """Be the arm until SIGTERM."""
    fault, seed, log = sys.argv[1], int(sys.argv[2]), sys.argv[3]
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    arm = StandIn(fault, seed)
    try:
        arm.run()
    except KeyboardInterrupt:
        pass
    finally:
        np.savez(log, rows=arm.rows, commands=arm.commands, fault_s=arm.fault_s)
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
