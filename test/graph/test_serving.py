"""The action of feedforward_controller, as MoveIt or anybody else may ask for it."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from action_msgs.msg import GoalStatus
from builtin_interfaces.msg import Duration
from control_msgs.action import FollowJointTrajectory
from control_msgs.msg import JointTolerance
from graph_harness import Graph
from rclpy.action import ActionClient
from tel_process import COARSE, HANG_S, PAPER, own_domain
from trajectory_msgs.msg import JointTrajectoryPoint

from tel_ros.recording.config_file import load_config
from tel_ros.recording.run_folder import network_after, trial_bags
from tel_ros.recording.trial_bag import read_trial

SERVER = "feedforward_controller"
NODES = ["sim_bridge", "inverse_dynamics", "trial_recorder", "ep_controller"]
JOINTS = ["shoulder", "elbow"]


class Service:
    """A graph with a service, and a client of its action."""

    def __init__(self, running: Graph) -> None:
        self.running, self.environment = running, dict(os.environ)  # each test has another domain
        self.start()

    def start(self) -> None:
        """Start the node as ``ros2 run`` does, and a client of it."""
        command = [sys.executable, "-m", "tel_ros.nodes.serving.feedforward_controller", "--ros-args"]
        command += ["-p", f"config:={self.running.folder / 'run.yaml'}"]
        self.server = subprocess.Popen(command, env=self.environment)
        running = self.running
        self.client = ActionClient(running.node, FollowJointTrajectory, f"{SERVER}/follow_joint_trajectory")
        running.meet(SERVER)
        running.spin_until(self.client.server_is_ready, "the action")

    def send(
        self,
        *positions: tuple[float, ...],
        duration_s: float = 1.0,
        joints: list[str] = JOINTS,
        path_rad: float = 0.0,
        on_feedback: Callable[[Any], None] = lambda message: None,
    ) -> Any:
        """Send a goal with points that are evenly spread in time, and return its handle."""
        goal = FollowJointTrajectory.Goal()
        goal.trajectory.joint_names = joints
        for k, position in enumerate(positions, start=1):
            t = k * duration_s / len(positions)
            time = Duration(sec=int(t), nanosec=int(t % 1.0 * 1e9))
            goal.trajectory.points.append(JointTrajectoryPoint(positions=position, time_from_start=time))
        goal.path_tolerance = [JointTolerance(name=joint, position=path_rad) for joint in joints]
        sent = self.client.send_goal_async(goal, lambda message: on_feedback(message.feedback))
        self.running.spin_until(sent.done, "the answer to the goal")
        return sent.result()

    def end(self, handle: Any) -> Any:
        """Wait for the end of a goal and return its status and its result."""
        future = handle.get_result_async()
        self.running.spin_until(future.done, "the result")
        return future.result()

    def run(self, *positions: tuple[float, ...], **more: Any) -> Any:
        return self.end(self.send(*positions, **more))

    @property
    def memory(self) -> dict[str, Any]:
        read: dict[str, Any] = json.loads((self.running.folder / "service.json").read_text())
        return read


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Service]:
    """Return a service that the tests ask for one trajectory after the other."""
    overrides = (*COARSE, "learning.name=rigid_body", "serve.bags=3")
    config = load_config(PAPER, overrides)
    folder = tmp_path_factory.mktemp("service") / "cell"
    with own_domain() as domain, Graph(config, folder, NODES, domain) as running:
        running.wait_for_controller()
        made = Service(running)
        yield made
        made.server.kill()
        made.server.wait()


def test_a_trajectory_is_slow_at_first_then_as_requested_and_each_execution_is_learned_from(
    service: Service,
) -> None:
    heard: list[Any] = []
    first = service.run((0.8, -0.5), on_feedback=heard.append)
    assert first.status == GoalStatus.STATUS_SUCCEEDED
    assert first.result.error_string.startswith("Goal successfully reached!; 4.00 times slower")
    assert heard and heard[0].header.frame_id.startswith("4.00 times slower than requested")
    assert heard[0].joint_names == JOINTS and len(heard[0].error.positions) == 2
    for position in [(0.0, 0.3), (0.8, -0.5), (0.0, 0.3)]:
        later = service.run(position)
        assert (later.status, later.result.error_code) == (GoalStatus.STATUS_SUCCEEDED, 0)
    assert "slower" not in later.result.error_string
    bag = trial_bags(service.running.folder)[-1]
    trial = read_trial(bag)
    np.testing.assert_allclose(trial.position_rad[-1], [0.0, 0.3], atol=0.02)
    assert trial.report.duration_s == pytest.approx(1.0, abs=0.01)
    assert service.memory["network"] == service.memory["executions"] == int(bag.name[-3:])
    assert network_after(service.running.folder, service.memory["network"]).is_file()


@pytest.mark.parametrize(
    ("positions", "more", "code", "said"),
    [
        (((0.1, np.nan),), {}, FollowJointTrajectory.Result.INVALID_GOAL, "elbow is nan"),
        (((0.1, 3.5),), {}, FollowJointTrajectory.Result.INVALID_GOAL, "elbow should be at"),
        (((1.0, 1.0),), {"duration_s": 0.03}, FollowJointTrajectory.Result.INVALID_GOAL, "rad/s"),
        (((0.1,),), {"joints": ["wrist"]}, FollowJointTrajectory.Result.INVALID_JOINTS, "wrist"),
        ((), {}, FollowJointTrajectory.Result.INVALID_GOAL, "Empty trajectory"),
    ],
)
def test_what_must_not_be_followed_is_refused_with_the_reason_and_nothing_moves(
    service: Service, positions: tuple, more: dict, code: int, said: str
) -> None:
    before = service.memory if (service.running.folder / "service.json").exists() else None
    refused = service.run(*positions, **more)
    assert refused.status == GoalStatus.STATUS_ABORTED
    assert refused.result.error_code == code
    assert said in refused.result.error_string
    assert before is None or service.memory == before


def test_cancelled_and_preempted_goals_end_with_their_results_and_teach_nothing(service: Service) -> None:
    heard: list[Any] = []
    handle = service.send((0.8, 0.8), duration_s=20.0, on_feedback=heard.append)
    service.running.spin_until(lambda: bool(heard), "feedback")
    cancelled = handle.cancel_goal_async()
    service.running.spin_until(cancelled.done, "the answer to the cancellation")
    ended = service.end(handle)
    assert (ended.status, ended.result.error_code) == (GoalStatus.STATUS_CANCELED, 0)
    network = service.memory["network"]
    heard.clear()
    first = service.send((0.8, 0.8), duration_s=20.0, on_feedback=heard.append)
    service.running.spin_until(lambda: bool(heard), "feedback")
    invalid = service.run((9.0, 9.0))
    assert invalid.status == GoalStatus.STATUS_ABORTED
    second = service.send((0.2, 0.2))
    preempted = service.end(first)
    assert preempted.status == GoalStatus.STATUS_ABORTED
    assert preempted.result.error_string == "Current goal cancelled due to new incoming action."
    assert service.end(second).status == GoalStatus.STATUS_SUCCEEDED
    assert service.memory["executions"] == service.memory["network"] > network


def test_a_joint_that_leaves_its_path_tolerance_ends_the_goal(service: Service) -> None:
    ended = service.run((1.2, -1.2), duration_s=8.0, path_rad=1e-6)
    assert ended.status == GoalStatus.STATUS_ABORTED
    assert ended.result.error_code == FollowJointTrajectory.Result.PATH_TOLERANCE_VIOLATED
    assert ended.result.error_string.startswith("Aborted due to path tolerance violation: ")


def test_only_the_last_recordings_and_networks_are_kept(service: Service) -> None:
    for k in range(12):
        assert service.run((0.1 * (k % 2), 0.2), duration_s=0.5).status == GoalStatus.STATUS_SUCCEEDED
    folder = service.running.folder
    assert len(trial_bags(folder)) == 3
    assert len(list((folder / "network").glob("after_*.npz"))) == 10


def test_a_service_that_was_killed_in_mid_motion_goes_on_with_what_it_had(service: Service) -> None:
    service.run((0.5, 0.5))
    before, heard, folder = service.memory, [], service.running.folder
    service.send((0.8, 0.8), duration_s=4.0, on_feedback=heard.append)
    service.running.spin_until(lambda: bool(heard), "feedback")
    service.server.kill()
    service.server.wait()
    # Its last network is broken as well: what it had before that is used.
    network_after(folder, before["network"]).write_bytes(b"broken")
    service.start()

    def went_on() -> Any:
        ended = service.run((0.5, 0.5))
        return ended if "another trial is under way" not in ended.result.error_string else None

    ended: list[Any] = []
    service.running.spin_until(lambda: bool(ended.append(went_on()) or ended[-1]), "the trial's end")
    assert ended[-1].status == GoalStatus.STATUS_SUCCEEDED, ended[-1].result
    last = f"the network after execution {before['network'] - 1} is used"
    assert last in ended[-1].result.error_string
    assert service.memory["executions"] > before["executions"] + 1  # no number of an execution comes twice
    assert service.memory["network"] == service.memory["executions"]
    assert before["movements"].keys() <= service.memory["movements"].keys()


def test_a_service_that_ends_cancels_what_is_under_way_and_brings_its_result(service: Service) -> None:
    heard: list[Any] = []
    handle = service.send((0.2, 0.8), duration_s=20.0, on_feedback=heard.append)
    service.running.spin_until(lambda: bool(heard), "feedback")
    service.server.send_signal(signal.SIGINT)
    ended = service.end(handle)
    assert ended.status == GoalStatus.STATUS_ABORTED and "cancelled" in ended.result.error_string
    service.server.wait(HANG_S)
