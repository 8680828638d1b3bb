"""The action practice as anybody may ask for it: reasons, report, pauses, stops, and a client that goes."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from graph_harness import Graph
from rcl_interfaces.srv import SetParameters
from rclpy.action import ActionClient
from rclpy.parameter import Parameter
from std_srvs.srv import SetBool, Trigger
from tel_interfaces.action import Practice
from tel_interfaces.msg import TrialResult
from tel_process import HANG_S, PAPER, QUICK, own_domain

from tel_ros.app.view.graph import GraphView
from tel_ros.recording import topics
from tel_ros.recording.config_file import load_config

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

    def send(self, run_dir: Path | str, on_feedback: Callable[[Any], None] | None = None) -> Any:
        sent = self.client.send_goal_async(Practice.Goal(run_dir=str(run_dir)), on_feedback)
        self.running.spin_until(sent.done, "the answer to the goal")
        return sent.result()

    def wants(self, trials: int) -> None:
        """Set how many trials a run has from now on."""
        value = Parameter("practice.trials", value=trials).to_parameter_msg()
        request = SetParameters.Request(parameters=[value])
        assert (
            self.running.call(SetParameters, "practice_manager/set_parameters", request).results[0].successful
        )

    def pause(self, wanted: bool) -> None:
        assert self.running.call(SetBool, topics.PAUSE, SetBool.Request(data=wanted)).success

    def end(self) -> None:
        self.client.destroy()
        self.manager.terminate()
        self.manager.wait(HANG_S)


@pytest.fixture(scope="module")
def asked(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Asked]:
    """Return a graph that the tests ask for one run after the other; each leaves it without a run."""
    folder = tmp_path_factory.mktemp("asked")
    # A strategy that goes on after trials that were aborted, and has always a next one.
    config = load_config(PAPER, (*QUICK, "practice.strategy=adaptive_extension"))
    with own_domain() as domain, Graph(config, folder / "graph", NODES, domain) as running:
        made = Asked(running, folder / "manager.log")
        yield made
        made.end()


def test_a_plain_goal_makes_the_report_and_a_relative_folder_is_refused_with_the_reason(
    asked: Asked, tmp_path: Path
) -> None:
    refused = asked.running.result_of(asked.send("bags/monday"))
    assert refused.outcome == "failed"
    assert "run_dir is 'bags/monday'; expected an absolute path" in refused.message
    run = tmp_path / "run"
    asked.wants(trials=1)
    done = asked.running.result_of(asked.send(run))
    assert done.outcome == "stopped" and len(done.trials) == 1, done.message
    assert (run / "report.html").is_file()
    said = asked.log.read_text()
    assert f"run {run} begins" in said and f"run {run} stopped" in said


def test_a_pause_holds_the_run_before_its_next_trial_until_it_is_taken_back(
    asked: Asked, tmp_path: Path
) -> None:
    person, goals, stages, told = asked.running, [], [], []

    def hear(message: Any) -> None:
        stages.append((message.feedback.trial, message.feedback.stage))
        told.extend(result.index for result in message.feedback.last)

    asked.wants(trials=20)
    asked.pause(True)
    handle = asked.send(tmp_path / "run", hear)
    person.spin_until(lambda: bool(stages), "the run")
    assert stages[-1] == (0, "paused")  # also a run that comes after it
    asked.pause(False)
    person.spin_until(lambda: stages[-1][1] != "paused", "the next trial")
    asked.pause(True)
    person.spin_until(lambda: stages[-1][1] == "paused", "the pause")
    assert f"trial {stages[-1][0] + 1}: " not in person.log("ep_controller")
    # A run that waits can be ended, as the live view's button does it.
    view = GraphView(person.node, person.config, goals.append, lambda feedback: None)
    person.meet("practice_manager")
    person.spin_until(lambda: bool(goals) and view.paused, "what the view listens to")
    view.end_run()
    person.spin_until(lambda: view.look_at_arm() or bool(view.answer), "the answer")
    assert view.answer == "stop: the run is ending"
    result = person.result_of(handle)
    assert result.outcome == "cancelled"
    assert told == [trial.index for trial in result.trials] == [1]  # once, pauses or not
    asked.pause(False)


def test_a_run_ends_at_an_emergency_stop_although_its_strategy_goes_on_after_aborts(
    asked: Asked, tmp_path: Path
) -> None:
    person = asked.running
    asked.wants(trials=20)
    person.client(Trigger, topics.SAFETY_STOP)
    handle = asked.send(tmp_path / "run")
    with person.time_stopped_in_motion():
        assert person.call(Trigger, topics.SAFETY_STOP, Trigger.Request()).success
    result = person.result_of(handle)
    assert result.outcome == "aborted"
    assert "emergency stop: as long as ep_controller runs on, nothing moves" in result.message
    assert result.trials[-1].outcome == TrialResult.ABORTED
    assert "emergency stop (/safety/stop)" in result.trials[-1].message

    def is_reset() -> bool:
        return bool(person.call(Trigger, topics.SAFETY_RESET, Trigger.Request()).success)

    person.spin_until(is_reset, "the reset")


def test_a_client_that_is_gone_is_noticed_and_the_run_goes_on(asked: Asked, tmp_path: Path) -> None:
    arrays: list[DiagnosticArray] = asked.running.listen(DiagnosticArray, topics.DIAGNOSTICS)
    asked.wants(trials=20)
    assert asked.send(tmp_path / "run").accepted
    asked.client.destroy()

    def warned() -> bool:
        statuses = [status for array in arrays for status in array.status]
        return any(s.name == "practice_manager: practice" and "is gone" in s.message for s in statuses)

    asked.running.spin_until(warned, "the warning")
    asked.client = ActionClient(asked.running.node, Practice, topics.PRACTICE)
