"""An arm as its contract sees it: two topics, and a push that is the same for efforts and for set points."""

from __future__ import annotations

import time
from collections.abc import Callable, Sized
from types import TracebackType

import numpy as np
import rclpy
from rclpy.context import Context
from rclpy.executors import Executor, SingleThreadedExecutor
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, MultiArrayDimension

from tel_ros.core.config import Config
from tel_ros.nodes.conversions import time_ns
from tel_ros.recording import topics

TINY_SHARE = 0.0025
"""Share of the effort limit that the tests use, on any arm."""
STILL_SHARE = 0.25
"""Less than this share of that push is none: a set point is as exact as the encoder that it was read from."""
IDLE_TURNS = 5
"""A turn of the executor may take no message although there is one."""
START_S = 30.0


def catch_up(executor: Executor, states: Sized) -> None:
    """Spin until nothing more is waiting that makes ``states`` longer."""
    idle = 0
    while idle < IDLE_TURNS:
        taken = len(states)
        executor.spin_once(timeout_sec=0.0)
        idle = idle + 1 if len(states) == taken else 0


def spin_until(executor: Executor, condition: Callable[[], bool], timeout_s: float, what: str) -> None:
    """Spin until a condition holds; fail the test when it does not come."""
    end = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < end, f"{what} did not come within {timeout_s} s"
        executor.spin_once(timeout_sec=0.02)


class ArmUnderTest:
    """A running arm and a client beside it. Use it with ``with``.

    Args:
        config: its configuration.
        lockstep: its time stands still without commands.
        obeys_nobody: it must not get commands that no arm may obey.
    """

    def __init__(self, config: Config, *, lockstep: bool, obeys_nobody: bool = False) -> None:
        self.config, self.lockstep, self.is_precious = config, lockstep, obeys_nobody
        self.joints = config.arm.joints
        self.takes_positions = config.arm.command_interface == "position"
        self.command_topic = topics.COMMANDS[config.arm.command_interface]
        self.tiny_nm = TINY_SHARE * np.array(config.arm.effort_limit_nm)
        self.states: list[JointState] = []
        self._context = Context()

    def __enter__(self) -> ArmUnderTest:
        """Wait for the arm."""
        rclpy.init(context=self._context)
        self.node = Node("contract_test", context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self.node.create_subscription(JointState, topics.JOINT_STATES, self.states.append, 5000)
        self._pub = self.node.create_publisher(Float64MultiArray, self.command_topic, 10)
        self.spin_until(
            lambda: len(self.states) > 2 and self._pub.get_subscription_count() > 0, START_S, "the arm"
        )
        self._posture_rad = self.position_rad(self.states[-1])
        self.rest = self.pushing(0.0)
        """The command with which the arm stays at rest where it was found."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Leave the arm at rest and go."""
        self.command(self.rest)
        time.sleep(0.02)
        self.node.destroy_node()
        self._context.try_shutdown()

    def spin_until(self, condition: Callable[[], bool], timeout_s: float, what: str) -> None:
        """Spin until a condition holds; fail the test when it does not come."""
        spin_until(self._executor, condition, timeout_s, what)

    def catch_up(self) -> None:
        """Take what has come while nobody spun: the newest state must not be one of long ago."""
        catch_up(self._executor, self.states)

    def new_states(self, n: int, timeout_s: float = 20.0) -> list[JointState]:
        """Return the next n messages of the arm."""
        self.catch_up()
        start = len(self.states)
        self.spin_until(lambda: len(self.states) >= start + n, timeout_s, f"{n} states")
        return self.states[start : start + n]

    def pushing(self, share: float) -> list[float]:
        """Return the command that exerts a share of the tiny effort, where the arm was found at rest."""
        effort_nm = share * self.tiny_nm
        if not self.takes_positions:
            return effort_nm.tolist()
        deflection_rad: np.ndarray = effort_nm / np.array(self.config.arm.stiffness_nm_per_rad)
        return (self._posture_rad + deflection_rad).tolist()

    def is_still(self, state: JointState) -> bool:
        """Return whether the state tells no effort, or none that is worth mentioning."""
        effort_nm = self.effort_nm(state)
        return effort_nm is None or bool(np.all(np.abs(effort_nm) <= STILL_SHARE * self.tiny_nm))

    def settle(self, timeout_s: float = 30.0) -> None:
        """Command rest until it has come to that; an arm that takes efforts only gets the command."""
        end = time.monotonic() + timeout_s
        self.answer(self.rest, 3)
        while self.takes_positions:
            start = len(self.states)
            self.answer(self.rest, 60)
            if all(map(self.is_still, self.states[start:])):
                return
            assert time.monotonic() < end, f"the arm is not at rest after {timeout_s} s"

    def command(self, values: list[float], answers_ns: int | None = None) -> None:
        """Send a command, labelled with the stamp of a state or not at all."""
        message = Float64MultiArray(data=values)
        if answers_ns is not None:
            n = len(values)
            message.layout.dim = [MultiArrayDimension(label=str(answers_ns), size=n, stride=n)]
        self._pub.publish(message)

    def answer(self, values: list[float], n: int = 1) -> list[tuple[int, JointState]]:
        """Answer n states in turn; return each stamp that was answered, and the state that followed."""
        pairs = []
        for _ in range(n):
            self.catch_up()
            stamp_ns = time_ns(self.states[-1].header.stamp)
            self.command(values, stamp_ns)
            self.spin_until(lambda s=stamp_ns: self.stamp_ns() > s, 10.0, "the next state")
            pairs.append((stamp_ns, self.states[-1]))
        return pairs

    def stamp_ns(self) -> int:
        """Return the stamp of the newest state."""
        return time_ns(self.states[-1].header.stamp)

    def effort_nm(self, state: JointState) -> list[float] | None:
        """Return the efforts in the order of the joints; None if the arm does not tell."""
        if len(state.effort) != len(state.name):
            return None
        values = [state.effort[list(state.name).index(joint)] for joint in self.joints]
        return None if np.isnan(values).any() else values

    def position_rad(self, state: JointState) -> np.ndarray:
        """Return the positions in the order of the joints."""
        return np.array([state.position[list(state.name).index(joint)] for joint in self.joints])
