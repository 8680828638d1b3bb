"""A recorder in a process of its own, what it hears of an arm and its controller, and what its bag has then.

Stamps are those of an arm whose clock is perfect; the values are sines with noise, so that they compress no
better than measured ones. Messages are made beforehand and get stamp and trial when they are sent.
"""

from __future__ import annotations

import multiprocessing
import os
import sys
import threading
import time
from array import array
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.serialization import serialize_message
from rosbags.highlevel import AnyReader
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, MultiArrayDimension, MultiArrayLayout
from tel_interfaces.msg import ControlState, TrialGoal, TrialResult
from tel_interfaces.srv import StartRecording, StopRecording

from tel_ros.core.types import NS_PER_S
from tel_ros.nodes import qos
from tel_ros.nodes.conversions import to_time
from tel_ros.nodes.trial_recorder import main as recorder_main
from tel_ros.recording import topics

ANSWER_TIMEOUT_S = 60.0
SPAWNER = multiprocessing.get_context("forkserver")
SPAWNER.set_forkserver_preload(["tel_ros.nodes.trial_recorder"])
_TYPES = {
    topics.JOINT_STATES: JointState,
    topics.EFFORT_COMMANDS: Float64MultiArray,
    topics.POSITION_COMMANDS: Float64MultiArray,
    topics.CONTROL_STATES: ControlState,
}
Sent = tuple[str, int, bytes]
"""Topic, stamp in ns, bytes."""


class Stream:
    """Publishes a tick's messages again and again from when it is entered until it is left."""

    def __init__(
        self, node: Node, rate_hz: float, n_joints: int, command_topics: tuple[str, ...], seed: int
    ) -> None:
        self.period_ns = round(NS_PER_S / rate_hz)
        types = self.types(command_topics)
        self._publishers = {t: node.create_publisher(kind, t, qos.STREAM) for t, kind in types.items()}
        self._joints = [f"joint_{k + 1}" for k in range(n_joints)]
        self._pool = self._made_beforehand(round(rate_hz), np.random.default_rng(seed))
        self._lock = threading.Lock()
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self.stamp_ns = time.time_ns()
        self.trial = 0
        """Index of the trial under way; 0: none."""
        self.sent: list[Sent] = []
        """What has been sent since :meth:`begin`."""

    @staticmethod
    def types(command_topics: tuple[str, ...]) -> dict[str, type]:
        return {t: _TYPES[t] for t in (topics.JOINT_STATES, *command_topics, topics.CONTROL_STATES)}

    def begin(self, trial: int) -> None:
        with self._lock:
            self.sent, self.trial = [], trial

    def end(self, trial: int) -> TrialResult:
        """Let the trial end with the last tick, and return its result."""
        with self._lock:
            self.trial = 0
            ticks = [stamp for topic, stamp, raw in self.sent if topic == topics.CONTROL_STATES]
        return TrialResult(
            index=trial,
            duration_s=len(ticks) * self.period_ns / NS_PER_S,
            start_stamp=to_time(ticks[0]),
            run_stamp=to_time(ticks[0]),
            end_stamp=to_time(ticks[-1]),
            ticks=len(ticks),
            joint_names=self._joints,
        )

    def goal(self, trial: int, n_points: int) -> TrialGoal:
        values = array("d", np.random.default_rng(trial).normal(size=n_points * len(self._joints)))
        times = array("q", (self.period_ns * np.arange(n_points)).tolist())
        names = ("position_rad", "velocity_rad_s", "acceleration_rad_s2", "equilibrium_rad")
        points = dict.fromkeys(names, values)
        return TrialGoal(trial=trial, alpha=1.0, joint_names=self._joints, time_ns=times, **points)

    def __enter__(self) -> Stream:
        self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._stopping.set()
        self._thread.join()

    def _run(self) -> None:
        next_s, tick = time.monotonic(), 0
        while not self._stopping.is_set():
            with self._lock:
                self._tick(self._pool[tick % len(self._pool)])
            tick += 1
            next_s += self.period_ns / NS_PER_S  # what was missed is caught up with
            time.sleep(max(0.0, next_s - time.monotonic()))

    def _tick(self, messages: dict[type, Any]) -> None:
        self.stamp_ns += self.period_ns
        stamp = to_time(self.stamp_ns)
        messages[JointState].header.stamp = messages[ControlState].header.stamp = stamp
        messages[ControlState].trial = self.trial
        messages[Float64MultiArray].layout.dim[0].label = str(self.stamp_ns)
        for topic, publisher in self._publishers.items():
            raw = serialize_message(messages[_TYPES[topic]])
            publisher.publish(raw)
            self.sent.append((topic, self.stamp_ns, raw))

    def _made_beforehand(self, n: int, rng: np.random.Generator) -> list[dict[type, Any]]:
        n_joints = len(self._joints)
        phase = 2.0 * np.pi * (np.arange(n)[:, None] / n + rng.random(n_joints))
        of_state = ("position_rad", "velocity_rad_s", "effort_nm", "equilibrium_rad")
        of_goal = ("desired_position_rad", "desired_velocity_rad_s", "desired_acceleration_rad_s2")
        pool: list[dict[type, Any]] = []
        for row in np.sin(phase):
            values = {
                name: array("d", row + 1e-4 * rng.normal(size=n_joints)) for name in (*of_state, *of_goal)
            }
            position, velocity, effort = (values[name] for name in of_state[:3])
            state = JointState(name=self._joints, position=position, velocity=velocity, effort=effort)
            layout = MultiArrayLayout(dim=[MultiArrayDimension(size=n_joints, stride=n_joints)])
            control = ControlState(phase=ControlState.RUN, saturated=[False] * n_joints, **values)
            command = Float64MultiArray(layout=layout, data=effort)
            pool.append({JointState: state, ControlState: control, Float64MultiArray: command})
        return pool


class Client(Node):
    """Calls the recorder's services."""

    def __init__(self, context: Context) -> None:
        super().__init__("recorder_client", context=context)
        self.spinner = SingleThreadedExecutor(context=context)
        self.spinner.add_node(self)
        self._start = self.create_client(StartRecording, topics.START_RECORDING)
        self._stop = self.create_client(StopRecording, topics.STOP_RECORDING)

    def call_start(self, bag: Path, goal: TrialGoal) -> Any:
        metadata = {"metadata_keys": ["seed"], "metadata_values": ["1"]}
        return self._start.call_async(StartRecording.Request(bag=str(bag), goal=goal, **metadata))

    def call_stop(self, result: TrialResult) -> Any:
        return self._stop.call_async(StopRecording.Request(result=result))

    def spin_for(self, duration_s: float, until: Callable[[], bool] = lambda: False) -> bool:
        """Spin for a while; return whether a condition came true, which ends it."""
        end = time.monotonic() + duration_s
        while not (met := until()) and time.monotonic() < end:
            self.spinner.spin_once(timeout_sec=0.01)
        return met

    def require(self, condition: Callable[[], bool], otherwise: str) -> None:
        """Spin until a condition is true; TimeoutError if it does not come true."""
        if not self.spin_for(ANSWER_TIMEOUT_S, condition):
            raise TimeoutError(otherwise)

    def wait_for_recorder(self) -> None:
        services = (self._start, self._stop)
        self.require(lambda: all(s.service_is_ready() for s in services), "the recorder did not come up")

    def answer(self, future: Any) -> Any:
        """Wait for an answer that has to say success."""
        self.require(future.done, "the recorder does not answer")
        if not future.result().success:
            raise RuntimeError(future.result().message)
        return future.result()


@contextmanager
def beside(domain: int, target: Callable[..., None], *arguments: Any) -> Iterator[tuple[Any, Client]]:
    """Run a process in a ROS domain, with a client beside it; end both."""
    process = SPAWNER.Process(target=target, args=(domain, *arguments), daemon=True)
    process.start()
    context = Context()
    rclpy.init(context=context, domain_id=domain)
    client = Client(context)
    try:
        yield process, client
    finally:
        process.kill()
        process.join()
        client.destroy_node()
        context.try_shutdown()


def record(domain: int, storage: str, chunk_s: float) -> None:
    """Be the recorder; runs in a process of its own."""
    os.environ["ROS_DOMAIN_ID"] = str(domain)
    sys.argv = ["trial_recorder", "--ros-args", "--log-level", "error"]
    sys.argv += ["-p", f"recording.storage:={storage}", "-p", f"recording.chunk_s:={chunk_s}"]
    recorder_main()


def in_bag(bag: Path) -> dict[str, dict[int, bytes]]:
    """Return the live messages in a bag: topic to stamp to bytes."""
    found: dict[str, dict[int, bytes]] = {}
    with AnyReader([bag]) as reader:
        for connection, time_ns, raw in reader.messages():
            topic = connection.topic.removeprefix("/")
            if topic not in topics.RECORDED_ONCE:
                found.setdefault(topic, {})[time_ns] = bytes(raw)
    return found


def is_same(received: bytes, sent: bytes) -> bool:
    """Return whether a message is as it was sent.

    The middleware fills it up to a multiple of four bytes, and says by how much in the third and fourth byte.
    """
    return received[:2] == sent[:2] and received[4:] == sent[4:] + bytes(-len(sent) % 4)
