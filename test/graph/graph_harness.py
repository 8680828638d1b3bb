"""Running the real graph from a test: processes over DDS, and a client beside them."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import rclpy
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rclpy.action import ActionClient
from rclpy.client import Client
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool
from std_srvs.srv import Trigger
from tel_interfaces.action import ExecuteTrial
from tel_interfaces.msg import ControlState, TrialGoal
from tel_process import HANG_S

from tel_ros.app.bring_up import NodeProcesses
from tel_ros.core import trial
from tel_ros.core.config import Config
from tel_ros.core.trajectories.trajectory import DesiredTrajectory, sample
from tel_ros.nodes import qos
from tel_ros.nodes.conversions import to_goal_message
from tel_ros.nodes.waiting import Liveness
from tel_ros.recording import topics
from tel_ros.recording.run_folder import CONFIG_FILE, create_run_folder
from tel_ros.recording.waypoint_file import load_path

MOVING_RAD_S = 0.5
"""A joint at this speed is in mid-motion."""


def _moves(newest: list[ControlState]) -> bool:
    """Return whether the newest control state, if there is one, is of an arm in mid-motion."""
    if not newest or newest[0].phase != ControlState.RUN:
        return False
    return max(abs(speed) for speed in newest[0].velocity_rad_s) > MOVING_RAD_S


class Graph:
    """Some of the nodes in processes of their own, and a client beside them.

    Args:
        config: of the nodes.
        folder: for the configuration and the logs; must not exist.
        names: which nodes to start.
        domain: ROS domain.
    """

    def __init__(self, config: Config, folder: Path, names: list[str], domain: int) -> None:
        self.config, self.folder = config, folder
        create_run_folder(folder, config)
        self.processes = NodeProcesses(folder / CONFIG_FILE, names, folder / "log")
        self.context = Context()
        rclpy.init(context=self.context, domain_id=domain)
        self.node = Node("test", context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.trials = ActionClient(self.node, ExecuteTrial, topics.EXECUTE_TRIAL)
        self._clients: dict[str, Client] = {}

    def __enter__(self) -> Graph:
        self.processes.__enter__()
        return self

    def __exit__(self, *error: Any) -> None:
        self.processes.stop()
        self.trials.destroy()
        self.node.destroy_node()
        self.context.try_shutdown()

    def spin_until(self, condition: Callable[[], bool], what: str) -> None:
        """Spin the client until a condition holds; fail the test when it does not come."""
        end = time.monotonic() + HANG_S
        while not condition():
            assert time.monotonic() < end, f"{what} did not come within {HANG_S} s\n{self._logs()}"
            self.executor.spin_once(timeout_sec=0.05)

    def spin_for(self, duration_s: float) -> None:
        """Spin the client for a while."""
        end = time.monotonic() + duration_s
        while time.monotonic() < end:
            self.executor.spin_once(timeout_sec=0.05)

    def listen(self, kind: type, topic: str, depth: int = 1000) -> list[Any]:
        """Return a list that the messages of a topic are appended to."""
        heard: list[Any] = []
        self.node.create_subscription(kind, topic, heard.append, depth)
        return heard

    def call(self, kind: type, name: str, request: Any) -> Any:
        """Call a service."""
        future = self.client(kind, name).call_async(request)
        self.spin_until(future.done, f"an answer of {name}")
        return future.result()

    def client(self, kind: type, name: str) -> Client:
        """Return the client of a service whose node knows it."""
        if name not in self._clients:
            client = self._clients[name] = self.node.create_client(kind, name)
            self.spin_until(client.service_is_ready, name)
            self.meet(self._server_of(client.service_name))
        return self._clients[name]

    def _server_of(self, service: str) -> str:
        """Return the node that offers a service, which is there."""
        found: list[str] = []

        def finds() -> bool:
            for name, space in self.node.get_node_names_and_namespaces():
                offered = self.node.get_service_names_and_types_by_node(name, space)
                found.extend([f"{space.rstrip('/')}/{name}"] if service in dict(offered) else [])
            return bool(found)

        self.spin_until(finds, f"the node of {service}")
        return found[0]

    def meet(self, node: str) -> None:
        """Wait until a node knows everything that this one has made before: nothing is lost from then on."""
        other = Liveness(self.node, node)
        self.spin_until(lambda: other.ask() >= 0.0 and other.met, f"an answer of {node}")

    def change_state(self, transition: int) -> bool:
        """Ask the controller for a transition; return whether it has done it."""
        request = ChangeState.Request(transition=Transition(id=transition))
        return bool(self.call(ChangeState, f"{topics.EP_CONTROLLER}/change_state", request).success)

    def activate_controller(self) -> None:
        """Configure and activate the controller."""
        assert self.change_state(Transition.TRANSITION_CONFIGURE)
        assert self.change_state(Transition.TRANSITION_ACTIVATE)

    def wait_for_controller(self) -> None:
        """Activate the controller, and wait until it sees the arm and the arm hears it."""
        self.activate_controller()
        heard: list[Any] = []
        self.node.create_subscription(Bool, topics.READY, heard.append, qos.LATCHED)
        self.spin_until(self.trials.server_is_ready, topics.EXECUTE_TRIAL)
        for name in (topics.SAFETY_STOP, topics.SAFETY_RESET):
            self.client(Trigger, name)  # at hand when they are needed
        for name in self.processes.pids:
            self.meet(name)
        self.spin_until(lambda: bool(heard) and heard[-1].data, topics.READY)

    def goal(self, duration_s: float = 5.0) -> TrialGoal:
        """Return a good goal: the configured path, the desired positions as equilibrium points."""
        desired = self.desired(duration_s)
        goal = trial.TrialGoal(1, 1.0, desired, desired.position_rad)
        return to_goal_message(goal, self.config.arm.joints)

    def desired(self, duration_s: float) -> DesiredTrajectory:
        """Return the configured path at a duration."""
        return sample(load_path(self.config.path, self.config.arm), duration_s, self.config.control.rate_hz)

    def send(self, goal: TrialGoal, feedback: list[Any] | None = None) -> Any:
        """Send a trial and return the goal handle."""
        on_feedback = None if feedback is None else lambda message: feedback.append(message.feedback)
        sent = self.trials.send_goal_async(ExecuteTrial.Goal(goal=goal), feedback_callback=on_feedback)
        self.spin_until(sent.done, "the answer to the goal")
        return sent.result()

    def start_moving(self, duration_s: float = 12.0) -> Any:
        """Send a trial, and return its goal handle as soon as the arm is in mid-motion.

        Simulated time runs on while this process waits for a core: so the trial is long, and only the
        newest state is looked at, never a queue of older ones.
        """
        with self._newest_control_state() as newest:
            handle = self.send(self.goal(duration_s))
            end = handle.get_result_async()

            def moves() -> bool:
                assert not end.done(), f"the trial has ended without that: {end.result().result.result}"
                return _moves(newest)

            self.spin_until(moves, f"a joint at more than {MOVING_RAD_S} rad/s")
        return handle

    @contextmanager
    def time_stopped_in_motion(self) -> Iterator[None]:
        """Keep the process of the simulated arm stopped while that is in mid-motion (in lockstep)."""
        with self._newest_control_state() as newest:
            for _ in range(20):  # between the look and the signal the arm may have come to a turn of its path
                self.spin_until(lambda: _moves(newest), f"a joint at more than {MOVING_RAD_S} rad/s")
                self.signal("sim_bridge", signal.SIGSTOP)
                try:
                    self.spin_for(0.2)  # for what is under way
                    if _moves(newest):
                        yield
                        return
                finally:
                    self.signal("sim_bridge", signal.SIGCONT)
        raise AssertionError("the arm was never stopped in mid-motion")

    @contextmanager
    def _newest_control_state(self) -> Iterator[list[ControlState]]:
        """Return a list that has the newest control state, or none yet."""
        newest: list[ControlState] = []
        listener = self.node.create_subscription(
            ControlState, topics.CONTROL_STATES, lambda message: newest.__setitem__(slice(None), [message]), 1
        )
        self.meet(topics.EP_CONTROLLER)
        self.spin_until(lambda: listener.get_publisher_count() > 0, topics.CONTROL_STATES)
        try:
            yield newest
        finally:
            self.node.destroy_subscription(listener)

    @contextmanager
    def nothing_left(self) -> Iterator[None]:
        """Take back what is made on the client's node meanwhile: others use this graph as well."""
        subscriptions, publishers = set(self.node.subscriptions), set(self.node.publishers)
        yield
        for subscription in set(self.node.subscriptions) - subscriptions:
            self.node.destroy_subscription(subscription)
        for publisher in set(self.node.publishers) - publishers:
            self.node.destroy_publisher(publisher)

    def where_time_stands_still(self) -> JointState:
        """Return the state that the simulated arm was left in: in lockstep it waits there for an answer."""
        arm = self.listen(JointState, topics.JOINT_STATES, depth=1)
        self.spin_until(lambda: bool(arm), "a joint state")
        return arm[-1]

    def result_of(self, handle: Any) -> Any:
        """Wait for the end of an action and return its result."""
        future = handle.get_result_async()
        self.spin_until(future.done, "the result")
        return future.result().result

    def result(self, handle: Any) -> Any:
        """Wait for the end of a trial and return its result."""
        return self.result_of(handle).result

    def signal(self, name: str, number: signal.Signals) -> None:
        """Send a signal to a node."""
        os.kill(self.processes.pids[name], number)

    def log(self, name: str) -> str:
        """Return what a node has said."""
        return (self.folder / "log" / f"{name}.log").read_text()

    def _logs(self) -> str:
        return "\n".join(f"--- {name}\n{self.log(name)}" for name in self.processes.pids)
