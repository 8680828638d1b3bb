"""One practice run, from the configuration to the finished run folder."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import rclpy
from rclpy.action import ActionClient
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.task import Future
from tel_interfaces.action import Practice

from tel_ros.app.bring_up import ASKED, NodeProcesses, node_names, preloading, require_simulator
from tel_ros.app.errors import GraphError, Interruption
from tel_ros.core.config import Config, PathConfig
from tel_ros.core.control.tracking import Limits
from tel_ros.core.errors import ConfigError, TrajectoryError
from tel_ros.core.practice.feasibility import require_within_velocity_limits
from tel_ros.core.practice.movement_path import command, desired_trajectory
from tel_ros.core.practice.strategies import make_strategy
from tel_ros.core.practice.strategy import Movement
from tel_ros.core.springs import Springs
from tel_ros.core.trial import TrialGoal
from tel_ros.local_stop import controllers, domain_id
from tel_ros.nodes.runner import start_ros
from tel_ros.nodes.waiting import Liveness
from tel_ros.recording import topics
from tel_ros.recording.run_folder import CONFIG_FILE, LOG_FOLDER, create_run_folder, run_lock
from tel_ros.recording.waypoint_file import load_known_path, load_path

if TYPE_CHECKING:
    from subprocess import Popen

    from tel_ros.recording.resumption import Resumption

DISCOVERY_S = 1.5
START_TIMEOUT_S = 30.0
SHUTDOWN_TIMEOUT_S = 10.0
RESUME_TIMEOUT_S = 120.0
"""Arm and controller of a resumed run take the processor for the trials of before while the others start."""
SILENCE_TIMEOUT_S = 20.0
"""A machine may stand still for some seconds."""

OnFeedback = Callable[[Practice.Feedback], None]
Beside = Callable[[Path, Path], AbstractContextManager]
"""From the configuration's file and the folder of the logs to what goes on beside a run: it is entered before
the nodes start, and left after the last of them has ended."""


def check_before_moving(config: Config) -> None:
    """Make sure that there is such a learner, and that all planned trials stay within the limits of the arm.

    Raises:
        ConfigError: the learner is not known or cannot do what is asked; the movement leaves
            the range of a joint or is too fast for it.
        InputFileError: the file of waypoints is missing or malformed.
        ModuleNotFoundError: PyBullet is missing, which the simulated arm needs.
    """
    from tel_ros.recording.network_file import new_network  # late: learners take long to import

    if config.run.arm == "sim":
        require_simulator()
    new_network(config)
    path, known_path = load_path(config.path, config.arm), load_known_path(config.path, config.arm)
    strategy = make_strategy(config)
    require_within_velocity_limits(config, strategy.fastest_movements(), path, known_path)
    limits = Limits.of(config.arm, config.control.path_tolerance_rad)
    # Where an effort share is given, nobody knows the duration yet; it will keep the limits by itself.
    for movement in (m for m in dict.fromkeys(strategy.preview()) if m.effort_share is None):
        desired = desired_trajectory(path, known_path, movement, config.control.rate_hz)
        springs, equilibrium_rad = command(Springs.of(config.arm), movement, desired, desired.position_rad)
        goal = TrialGoal(1, 1.0, desired, equilibrium_rad, springs)
        try:
            limits.check_goal(goal, config.control.settle_speed_rad_s)
        except TrajectoryError as error:
            key, value = _path_of(config.path, movement)
            raise ConfigError(
                key, value, f"a path that the arm can follow in {movement.duration_s} s: {error}"
            ) from None


def _path_of(path: PathConfig, movement: Movement) -> tuple[str, str]:
    """Return the key that names the path of a movement, and what it says."""
    known = movement.shape == 0.0
    if path.files and not known:
        return "path.files", path.files[path.names.index(movement.path)]
    name, file = ("known_name", "known_file") if known else ("name", "file")
    key = file if getattr(path, file) else name
    return f"path.{key}", getattr(path, key)


def practise(
    config: Config, folder: Path, on_feedback: OnFeedback, beside: Beside, namespace: str = "/"
) -> Practice.Result:
    """Bring the graph up, run practice into a folder that must not exist, take the graph down.

    Raises:
        ConfigError, InputFileError: something about the run is wrong; nothing has moved.
        ModuleNotFoundError: PyBullet is missing, which the simulated arm needs; nothing was started.
        GraphError: a graph is running already, a node died or did not come up; the graph is down.
        Interrupted: by a signal, after the graph was taken down; says what was seen of the arm.
    """
    with client_node(config, namespace) as (node, waiting):
        create_run_folder(folder, config)
        with run_lock(folder):
            return _run(node, config, folder, on_feedback, beside, waiting, resume=False)


def resume(
    folder: Path,
    on_prepared: Callable[[Resumption], None],
    on_feedback: OnFeedback,
    beside: Beside,
    namespace: str = "/",
) -> Practice.Result:
    """Go on with a run that was interrupted, after its last whole trial.

    ``on_prepared`` is called with what the run goes on from, before any node is started.

    Raises:
        As for :func:`practise`; and InputFileError also if the run is finished.
    """
    from tel_ros.recording.resumption import prepare_to_resume, resumed_config

    config = resumed_config(folder)
    # The nodes of the run may still be on their way to bring the arm to rest.
    with run_lock(folder), client_node(config, namespace) as (node, waiting):
        on_prepared(prepare_to_resume(folder, config))
        return _run(node, config, folder, on_feedback, beside, waiting, resume=True)


@contextmanager
def client_node(
    config: Config,
    namespace: str,
    asked: str = "practice_manager",
    check: Callable[[Config], None] = check_before_moving,
) -> Iterator[tuple[Node, dict[str, Popen[bytes]]]]:
    """Make the node that asks for a run that can be done, where no graph is running, and its executor.

    Meanwhile the processes of the run's nodes import what they need: they come as well. ``asked``: the one
    that has the arm moved. ``check``: raises if that cannot be done.
    """
    if config.run.arm == "sim":
        # The simulated arm concerns nobody else on the network.
        os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    start_ros()
    try:
        node = Node("tel", namespace=namespace)
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        discovered_at = time.monotonic() + DISCOVERY_S
        with preloading(node_names(config, asked)) as waiting:
            check(config)  # while others are being discovered
            _refuse_second_graph(node, executor, config, discovered_at)
            yield node, waiting
        node.destroy_node()
    finally:
        # Fast DDS sometimes blocks here for ever: then the kernel ends the process.
        signal.setitimer(signal.ITIMER_REAL, SHUTDOWN_TIMEOUT_S)
        rclpy.try_shutdown()
        signal.setitimer(signal.ITIMER_REAL, 0.0)


def _refuse_second_graph(
    node: Node, executor: SingleThreadedExecutor, config: Config, discovered_at: float
) -> None:
    ours, all_are_known, space = {*node_names(config), *ASKED}, False, node.get_namespace()
    while not all_are_known:
        all_are_known = time.monotonic() >= discovered_at
        executor.spin_once(timeout_sec=0.1)
        here = {name for name, its in node.get_node_names_and_namespaces() if its == space}
        # Discovery can take longer on a busy machine; controllers on this one need none.
        if any(each.domain == domain_id() and each.is_in(space) for each in controllers()):
            here.add(topics.EP_CONTROLLER)
        running = sorted(ours & here)
        if config.run.arm == "sim" and node.count_publishers(topics.JOINT_STATES):
            running.append(f"a publisher of {node.resolve_topic_name(topics.JOINT_STATES)}")
        if running:
            domain = os.environ.get("ROS_DOMAIN_ID", "0")
            free = f"a domain or --namespace without a running graph (found {', '.join(running)})"
            raise ConfigError("ROS_DOMAIN_ID", domain, free)


def _run(
    node: Node,
    config: Config,
    folder: Path,
    on_feedback: OnFeedback,
    beside: Beside,
    waiting: dict[str, Popen[bytes]],
    resume: bool,
) -> Practice.Result:
    executor, config_file, logs = node.executor, folder / CONFIG_FILE, folder / LOG_FOLDER
    assert executor is not None  # client_node
    space = node.get_namespace()
    nodes = NodeProcesses(
        config_file, node_names(config), logs, resume=resume, namespace=space, waiting=waiting
    )
    start_timeout_s = RESUME_TIMEOUT_S if resume else START_TIMEOUT_S
    with beside(config_file, logs), nodes:
        client = ActionClient(node, Practice, topics.PRACTICE)
        liveness = Liveness(node, "practice_manager")  # after the client: see meet()

        def spin_until(done: Callable[[], bool], timeout_s: float, what: str) -> None:
            end = time.monotonic() + timeout_s
            while not done():
                executor.spin_once(timeout_sec=0.1)
                Interruption.check()
                nodes.check()
                if time.monotonic() > end:
                    raise GraphError(f"{what} within {timeout_s:.0f} s; see the logs in {logs}")

        def is_met() -> bool:
            liveness.ask()
            return liveness.met and client.server_is_ready()

        try:
            spin_until(is_met, start_timeout_s, "the practice manager did not come up")
            goal = Practice.Goal(run_dir=str(folder.resolve()))
            accepted = client.send_goal_async(goal, lambda message: on_feedback(message.feedback))
            spin_until(accepted.done, start_timeout_s, "the practice manager did not answer")
            handle: Any = accepted.result()
            if not handle.accepted:
                raise GraphError("the practice manager rejected the run")
            finished: Future = handle.get_result_async()

            def is_finished() -> bool:
                silence_s = liveness.ask()
                if silence_s > SILENCE_TIMEOUT_S:
                    raise GraphError(f"node practice_manager has not answered for {silence_s:.0f} s")
                return finished.done()

            spin_until(is_finished, float("inf"), "")
            result: Practice.Result = finished.result().result
            return result
        finally:
            client.destroy()
