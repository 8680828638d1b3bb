"""The action practice as anybody may ask for it: reasons, report, and a client that goes."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from graph_harness import Graph
from rclpy.action import ActionClient
from tel_interfaces.action import Practice
from tel_process import HANG_S, QUICK

from tel_ros.recording import topics

NODES = ["sim_bridge", "inverse_dynamics", "trial_recorder", "ep_controller"]


class Asked:
    """A graph whose manager is started as ``ros2 run`` starts it, and a client of its action."""

    def __init__(self, running: Graph, log: Path) -> None:
        self.running, self.log = running, log
        command = [sys.executable, "-m", "tel_ros.nodes.practice_manager", "--ros-args"]
        command += ["-p", f"config:={running.folder / 'run.yaml'}"]
        with log.open("w") as said:
            self.manager = subprocess.Popen(command, stderr=said)
        self.client = ActionClient(running.node, Practice, topics.PRACTICE)
        running.meet("practice_manager")
        running.spin_until(self.client.server_is_ready, topics.PRACTICE)

    def send(self, run_dir: str) -> Any:
        sent = self.client.send_goal_async(Practice.Goal(run_dir=run_dir))
        self.running.spin_until(sent.done, "the answer to the goal")
        return sent.result()

    def end(self) -> None:
        self.client.destroy()
        self.manager.terminate()
        self.manager.wait(HANG_S)


@pytest.fixture
def asked(graph: Callable[..., Graph], tmp_path: Path) -> Iterator[Asked]:
    made = Asked(graph(NODES, *QUICK, "practice.trials=1"), tmp_path / "manager.log")
    yield made
    made.end()


def test_a_plain_goal_makes_the_report_and_a_relative_folder_is_refused_with_the_reason(
    asked: Asked, tmp_path: Path
) -> None:
    refused = asked.running.result_of(asked.send("bags/monday"))
    assert (
        refused.outcome == "failed"
        and "run_dir is 'bags/monday'; expected an absolute path" in refused.message
    )
    run = tmp_path / "run"
    done = asked.running.result_of(asked.send(str(run)))
    assert done.outcome == "completed", done.message
    assert (run / "report.html").is_file()
    said = asked.log.read_text()
    assert f"run {run} begins" in said and f"run {run} completed" in said


def test_a_client_that_is_gone_is_noticed_and_the_run_goes_on(asked: Asked, tmp_path: Path) -> None:
    arrays: list[DiagnosticArray] = asked.running.listen(DiagnosticArray, topics.DIAGNOSTICS)
    assert asked.send(str(tmp_path / "run")).accepted
    asked.client.destroy()

    def warned() -> bool:
        statuses = [status for array in arrays for status in array.status]
        return any(s.name == "practice_manager: practice" and "is gone" in s.message for s in statuses)

    asked.running.spin_until(warned, "the warning")
    asked.client = ActionClient(asked.running.node, Practice, topics.PRACTICE)
