"""Faults against a service.

    python -m pytest test/faults/test_serving_faults.py --serving-faults 60

After every fault it is asked whether each goal had its result (unless the server itself was killed), whether
memory and network can be read and nothing is lost, whether the arm is at rest or without effort, and whether
the service, started again where something has died, succeeds with its next goal.
"""

from __future__ import annotations

import json
import os
import random
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import psutil
import pytest
import rclpy
from action_msgs.msg import GoalStatus
from builtin_interfaces.msg import Duration
from control_msgs.action import FollowJointTrajectory
from rclpy.action import ActionClient
from rclpy.executors import SingleThreadedExecutor
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectoryPoint

from tel_ros.app.bring_up import NodeProcesses, node_names
from tel_ros.app.errors import GraphError
from tel_ros.nodes import qos
from tel_ros.nodes.waiting import Liveness
from tel_ros.recording.config_file import load_config
from tel_ros.recording.network_file import load_network
from tel_ros.recording.run_folder import CONFIG_FILE, network_after
from tel_ros.recording.service_folder import open_service

ROOT = Path(__file__).parents[2]
SERVER = "feedforward_controller"
RESULT_S, REST_S, AGAIN_S = 150.0, 40.0, 180.0
REST_RAD_S = 0.05
MOVEMENT_S, SPREAD_S = 8.0, 6.0
"""Of the trajectory, and within how long after its goal the fault comes (wall clock)."""


class Cell:
    """A service with its nodes, and a client of it."""

    def __init__(self, folder: Path, overrides: list[str]) -> None:
        self.folder = folder
        self.config = load_config(ROOT / "config" / "planar_arm.yaml", overrides)
        with open_service(folder, self.config):
            pass
        self.node, self.executor = rclpy.create_node("campaign"), SingleThreadedExecutor()
        self.executor.add_node(self.node)
        self.state: JointState | None = None
        self.node.create_subscription(JointState, "joint_states", self._hear, qos.NEWEST)
        self.nodes: NodeProcesses | None = None

    def _hear(self, state: JointState) -> None:
        self.state = state

    def start(self) -> None:
        names = node_names(self.config, SERVER)
        self.nodes = NodeProcesses(self.folder / CONFIG_FILE, names, self.folder / "log")
        self.nodes.__enter__()
        self.client = ActionClient(self.node, FollowJointTrajectory, f"{SERVER}/follow_joint_trajectory")
        liveness = Liveness(self.node, SERVER)
        assert self.until(lambda: liveness.ask() >= 0.0 and liveness.met, AGAIN_S), "the server is not there"
        assert self.until(self.client.server_is_ready, AGAIN_S), "the action is not there"

    def stop(self) -> None:
        if self.nodes is not None:
            for name in self.nodes.pids:
                self.signal(name, signal.SIGCONT)
            self.nodes.stop()
            self.client.destroy()
        self.nodes = None

    def signal(self, name: str, number: signal.Signals) -> None:
        assert self.nodes is not None
        process = psutil.Process(self.nodes.pids[name]) if psutil.pid_exists(self.nodes.pids[name]) else None
        if process is not None and process.status() != psutil.STATUS_ZOMBIE:
            os.kill(process.pid, number)

    @property
    def alive(self) -> bool:
        assert self.nodes is not None
        try:
            self.nodes.check()
        except GraphError:
            return False
        return True

    def until(self, condition: Callable[[], bool], timeout_s: float) -> bool:
        end = time.monotonic() + timeout_s
        while not condition() and time.monotonic() < end:
            self.executor.spin_once(timeout_sec=0.05)
        return condition()

    def spin(self, duration_s: float) -> None:
        self.until(lambda: False, duration_s)

    def send(self, there: float, duration_s: float) -> Goal:
        goal = FollowJointTrajectory.Goal()
        goal.trajectory.joint_names = list(self.config.arm.joints)
        time_s = Duration(sec=int(duration_s), nanosec=int(duration_s % 1.0 * 1e9))
        point = JointTrajectoryPoint(positions=[there, -there], time_from_start=time_s)
        goal.trajectory.points = [point]
        return Goal(self.client.send_goal_async(goal))

    def memory(self) -> dict[str, Any]:
        read: dict[str, Any] = json.loads((self.folder / "service.json").read_text())
        return read


class Goal:
    """A goal that was sent, and its result once it is there."""

    def __init__(self, sent: Any) -> None:
        self._sent, self._result = sent, None

    @property
    def done(self) -> bool:
        if self._result is None and self._sent.done() and self._sent.result().accepted:
            self._result = self._sent.result().get_result_async()
        rejected = self._sent.done() and not self._sent.result().accepted
        return rejected or (self._result is not None and self._result.done())

    def cancel(self) -> None:
        if self._sent.done() and self._sent.result().accepted:
            self._sent.result().cancel_goal_async()

    @property
    def text(self) -> str:
        if self._result is None or not self._result.done():
            return "rejected" if self.done else "no result"
        answer = self._result.result()
        return f"{answer.status}/{answer.result.error_code} {answer.result.error_string}"

    @property
    def succeeded(self) -> bool:
        return self.done and self.text.startswith(f"{GoalStatus.STATUS_SUCCEEDED}/")


def killed(name: str) -> Callable[[Cell, random.Random], list[Goal]]:
    def fault(cell: Cell, choice: random.Random) -> list[Goal]:
        cell.signal(name, signal.SIGKILL)
        assert cell.until(lambda: not cell.alive, REST_S)  # it takes its time
        return []

    return fault


def stopped(name: str) -> Callable[[Cell, random.Random], list[Goal]]:
    def fault(cell: Cell, choice: random.Random) -> list[Goal]:
        cell.signal(name, signal.SIGSTOP)
        cell.spin(choice.choice([1.0, 14.0]))
        cell.signal(name, signal.SIGCONT)
        return []

    return fault


def overlapping(cell: Cell, choice: random.Random) -> list[Goal]:
    goals = []
    for _ in range(6):
        goals.append(cell.send(choice.uniform(-1.0, 1.0), choice.uniform(0.5, 4.0)))
        cell.spin(choice.uniform(0.0, 0.3))
    choice.choice(goals).cancel()
    return goals


def full_disk(cell: Cell, choice: random.Random) -> list[Goal]:
    assert cell.nodes is not None
    writers = [
        psutil.Process(cell.nodes.pids[name]) for name in (SERVER, "trial_recorder", "inverse_dynamics")
    ]
    for each in writers:
        each.rlimit(psutil.RLIMIT_FSIZE, (0, -1))
    goals = [cell.send(0.2, 1.0)]
    cell.until(lambda: goals[0].done, RESULT_S)
    for each in writers:
        each.rlimit(psutil.RLIMIT_FSIZE, (-1, -1))
    return goals


def broken_network(cell: Cell, choice: random.Random) -> list[Goal]:
    file = network_after(cell.folder, cell.memory()["network"])
    whole = file.read_bytes()
    file.write_bytes(choice.choice([b"", b"broken", whole[: len(whole) // 2], choice.randbytes(len(whole))]))
    return [cell.send(0.3, 1.0)]


FAULTS = {
    "server killed": killed(SERVER),
    "controller killed": killed("ep_controller"),
    "controller silent": stopped("ep_controller"),
    "arm's states stop": stopped("sim_bridge"),
    "recorder killed": killed("trial_recorder"),
    "network killed": killed("inverse_dynamics"),
    "network silent": stopped("inverse_dynamics"),
    "goals that overlap": overlapping,
    "disk full": full_disk,
    "network file broken": broken_network,
}


def run(cell: Cell, name: str, choice: random.Random) -> tuple[list[str], str]:
    """Have one fault happen; return what is wrong after it, and what the first goal's result says."""
    if cell.nodes is None:
        cell.start()
    before = cell.memory()
    known_before = set(before["movements"])
    goals = [cell.send(choice.choice([0.9, -0.9]) + choice.uniform(-0.1, 0.1), MOVEMENT_S)]
    cell.spin(choice.uniform(0.0, SPREAD_S))
    goals += FAULTS[name](cell, choice)
    wrong = []
    server_died = name == "server killed"
    if not server_died and not cell.until(lambda: all(goal.done for goal in goals), RESULT_S):
        wrong.append(f"{sum(not goal.done for goal in goals)} of {len(goals)} goals have no result")
    said = "the server is gone" if server_died else goals[0].text
    cell.state = None

    def rests() -> bool:
        state = cell.state
        return state is not None and (
            not any(state.effort) or max(abs(speed) for speed in state.velocity) < REST_RAD_S
        )

    if not cell.until(rests, REST_S):
        seen = cell.state
        state = "no state comes" if seen is None else f"{list(seen.velocity)} rad/s, {list(seen.effort)} N·m"
        wrong.append(f"the arm is not seen at rest or without effort: {state}")
    if not cell.alive:
        cell.stop()
    try:
        after = cell.memory()
        if after["executions"] < before["executions"] or not known_before <= set(after["movements"]):
            wrong.append("the memory has lost something")
    except ValueError as error:
        wrong.append(f"the memory is not readable: {error}")
    if cell.nodes is None:
        cell.start()
    again: list[Goal] = []

    def succeeds() -> bool:
        if not again or (again[-1].done and not again[-1].succeeded):
            again.append(cell.send(choice.uniform(-0.5, 0.5), 1.0))
        return again[-1].succeeded

    if not cell.until(succeeds, AGAIN_S):
        wrong.append(f"the next goal does not succeed: {again[-1].text}")
    memory = cell.memory()
    try:
        if load_network(network_after(cell.folder, memory["network"])).trials_learned < 1:
            wrong.append("the network has learned nothing")
    except Exception as error:
        wrong.append(f"the network in use: {error}")
    return wrong, said


@pytest.mark.timeout(0)
def test_no_fault_costs_a_goal_its_result_a_network_or_the_arm_its_rest(
    pytestconfig: pytest.Config,
    tmp_path: Path,
    ros_domains: Iterator[int],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    options = pytestconfig.option
    if not (runs := getattr(options, "serving_faults", 0)):
        pytest.skip("--serving-faults asks for it")
    monkeypatch.setenv("ROS_DOMAIN_ID", str(next(ros_domains)))
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    rclpy.init()
    cell, bad = Cell(tmp_path / "cell", ["learning.name=rigid_body", *options.set]), []
    try:
        cell.start()
        for _ in range(3):
            first = cell.send(0.5, 1.0)
            assert cell.until(lambda goal=first: goal.done, RESULT_S), "no result without a fault"
        for k in range(runs):
            name = list(FAULTS)[k % len(FAULTS)]
            wrong, said = run(cell, name, random.Random(1000 * options.seed + k))
            bad += [f"{name}: {'; '.join(wrong)}"] if wrong else []
            with capsys.disabled():
                print(f"{k + 1:3d}  {name:20}  {'; '.join(wrong) or 'good'}  | {said[:150]}", flush=True)
    finally:
        cell.stop()
        rclpy.try_shutdown()
    assert bad == []
