"""A run that is paused, watched, and stopped from the page."""

from __future__ import annotations

import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from graph_harness import PAPER, QUICK, Graph, TelProcess, summary_of, wait_until
from rclpy.action import ActionClient
from std_srvs.srv import SetBool
from tel_interfaces.action import Practice

from tel_ros.app.bring_up import MODULES
from tel_ros.app.view.graph import GraphView
from tel_ros.recording import topics
from tel_ros.recording.config_file import load_config

pytestmark = pytest.mark.timeout(400)


def test_a_pause_holds_the_run_before_its_next_trial_until_it_is_taken_back(
    graph: Callable[..., Graph], tmp_path: Path
) -> None:
    person, goals, stages, told = graph([*MODULES], *QUICK), [], [], []

    def hear(message: Any) -> None:
        stages.append((message.feedback.trial, message.feedback.stage))
        told.extend(result.index for result in message.feedback.last)

    def pause(wanted: bool) -> None:
        assert person.call(SetBool, topics.PAUSE, SetBool.Request(data=wanted)).success

    client = ActionClient(person.node, Practice, topics.PRACTICE)
    person.spin_until(client.server_is_ready, 30.0, topics.PRACTICE)
    pause(True)
    sent = client.send_goal_async(Practice.Goal(run_dir=str(tmp_path / "run")), hear)
    person.spin_until(lambda: bool(stages), 60.0, "the run")
    assert stages[-1] == (0, "paused")  # also a run that comes after it
    for _ in range(2):
        pause(False)
        person.spin_until(lambda: stages[-1][1] != "paused", 60.0, "the next trial")
        pause(True)
        person.spin_until(lambda: stages[-1][1] == "paused", 60.0, "the pause")
        assert f"trial {stages[-1][0] + 1}: " not in person.log("ep_controller")
    # A run that waits can be ended, as the page's button does it.
    view = GraphView(person.node, load_config(PAPER), goals.append, lambda feedback: None)
    person.meet("practice_manager")
    person.spin_until(lambda: bool(goals) and view.paused, 60.0, "what the view listens to")
    view.end_run()
    person.spin_until(lambda: view.look_at_arm() or bool(view.answer), 30.0, "the answer")
    assert view.answer == "stop: the run is ending"
    result = person.result_of(sent.result())
    client.destroy()
    assert result.outcome == "cancelled"
    assert told == [trial.index for trial in result.trials]  # each once, pauses or not


def test_a_run_goes_on_without_its_view(tel: Callable[..., TelProcess]) -> None:
    pytest.importorskip("viser", reason="needs the extra view")
    run = tel("practice.trials=1", *QUICK[1:], more=("--view",))
    wait_until(lambda: "main" in run.nodes(), 60.0, "the view")
    view = run.nodes()["main"]
    wait_until(lambda: view.nice() >= 10, 60.0, "a view that lets the others go first")
    view.send_signal(signal.SIGKILL)
    _, out, err = run.finish()
    assert [trial["outcome"] for trial in summary_of(out)["trials"]] == ["completed"], err
    assert run.left_behind() == []
