"""The guard: brakes an arm whose controller is dead or hangs."""

from __future__ import annotations

import time
from functools import partial

import numpy as np
from rclpy.node import Node
from rclpy.subscription import Subscription
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from tel_ros.core.arm_state import ArmState
from tel_ros.core.control.guard import AwakeClock, CommandGuard
from tel_ros.core.errors import StateError
from tel_ros.core.safety.gate import StateGate
from tel_ros.core.types import NS_PER_S
from tel_ros.nodes.clock import STEADY, longest_silence_s
from tel_ros.nodes.command_channel import CommandChannel
from tel_ros.nodes.conversions import command_reader, joint_state_reader
from tel_ros.nodes.diagnostics import Diagnostics, Health, Level
from tel_ros.nodes.hot_loop import busy_subscription
from tel_ros.nodes.parameters import load_parameters
from tel_ros.nodes.runner import run_node
from tel_ros.recording import topics

COMPLAINT_PERIOD_S = 1.0
LOOK_PERIODS = 5.0
"""Joint states that fail to come: after so many, this process or the arm stood still, not the controller."""
_OWN_LABEL = topics.ARM_GUARD.encode()


class ArmGuardNode(Node):
    """Hears states and commands, and is silent while commands come; knows its own by their label."""

    def __init__(self) -> None:
        super().__init__(topics.ARM_GUARD)
        config = load_parameters(self, "arm", "control", "run", "safety", "sim")
        self._guard = CommandGuard(config.arm, config.control, config.safety)
        self._gate = StateGate(config.arm, config.control, config.safety.clock_drift)
        self._read_state, self._read_command = joint_state_reader(), command_reader()
        self._awake = AwakeClock(LOOK_PERIODS / config.control.rate_hz, time.monotonic())
        self._channel = CommandChannel(self, "effort", author=topics.ARM_GUARD)
        self._timeout_s = config.safety.command_timeout_s
        self._state_timeout_s = config.control.state_timeout_s
        self._state_at = time.monotonic()
        self._seen: ArmState | None = None
        self._blind = config.arm_waits_for_commands
        self._takeovers = self._commands = 0
        self.busy_subscriptions: list[Subscription] = []
        if config.arm_waits_for_commands:
            self.get_logger().warning("sim.clock is 'lockstep': the arm waits for commands, nothing to guard")
        else:
            self._channel.open(self._guard.safety)
            # Commands first: one that came with a state is heard before the guard judges whether one came.
            self.busy_subscriptions = [
                busy_subscription(self, Float64MultiArray, topics.EFFORT_COMMANDS, self._on_command),
                busy_subscription(self, JointState, topics.JOINT_STATES, self._on_joint_state),
            ]
            self.get_logger().info(f"watches {self._channel.topic}")
        self.create_timer(0.02, self._watch_states, clock=STEADY)
        self._diagnostics = Diagnostics(self, "command watch", config.arm.name, self._health)

    def stop(self) -> None:
        """Go on watching until there is nothing to watch."""

    @property
    def stopped(self) -> bool:
        """Whether the arm has its final effort, or no states come with which to brake it."""
        return self._guard.at_final_effort or self._blind

    def destroy_node(self) -> None:
        """Take a command back that is not to stay."""
        if self._guard.active and not self._guard.at_final_effort:
            self._guard.safety.none()
            self._channel.send(0)
        super().destroy_node()

    def _on_command(self, raw: bytes) -> None:
        try:
            command = self._read_command(raw)
        except StateError as error:
            self.get_logger().error(f"{error}; it is ignored", throttle_duration_sec=COMPLAINT_PERIOD_S)
            return
        if command.label == _OWN_LABEL:
            return
        self._commands += 1
        if self._guard.active:
            self.get_logger().warning("commands come again: the guard yields")
        self._guard.on_command(np.array(command.values), self._awake.look(time.monotonic()))

    def _on_joint_state(self, raw: bytes) -> None:
        arrived_ns = time.monotonic_ns()
        try:
            state = self._gate.admit(*self._read_state(raw), arrived_ns)
        except StateError as error:
            self.get_logger().error(f"{error}; it is ignored", throttle_duration_sec=COMPLAINT_PERIOD_S)
            return
        if state is not self._seen:  # one that repeats its stamp tells nothing
            self._seen, self._state_at, self._blind = state, arrived_ns / NS_PER_S, False
        now_s, was_active = self._awake.look(arrived_ns / NS_PER_S), self._guard.active
        if self._guard.on_state(state, now_s) is None:
            return
        self._channel.send(state.time_ns)
        if not was_active:
            self._takeovers += 1
            self.get_logger().error(
                f"no command for {self._timeout_s:g} s: the guard takes over and brakes the arm"
            )

    def _watch_states(self) -> None:
        """Command zero effort when no states come: without them the guard cannot brake."""
        if self._blind or not self._guard.active:
            return
        silent_s = time.monotonic() - self._state_at
        if silent_s > longest_silence_s(self._state_timeout_s):
            self._blind = True
            self.get_logger().error(f"no new joint state for {silent_s:.3f} s: zero effort")
            self._guard.safety.none()
            self._channel.send(0)

    def _health(self) -> Health:
        values = {
            "commands": self._commands,
            "take_overs": self._takeovers,
            "joint_state_age_s": f"{time.monotonic() - self._state_at:.3f}",
        }
        if not self._guard.active:
            told = f"; took over {self._takeovers} times" if self._takeovers else ""
            return Health(Level.WARN if told else Level.OK, f"watches the commands{told}", values)
        if self._blind:
            return Health(Level.ERROR, "commands and joint states have stopped: zero effort", values)
        done = "the arm rests" if self._guard.at_final_effort else "the arm is braked"
        return Health(Level.ERROR, f"commands have stopped: {done}", values)


main = partial(run_node, ArmGuardNode)

if __name__ == "__main__":
    main()
