"""What the live view hears of a graph and asks of it; the graph is one made-up node."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import rclpy
from action_msgs.msg import GoalInfo
from action_msgs.srv import CancelGoal
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool
from std_srvs.srv import SetBool, Trigger
from tel_interfaces.msg import ControlState
from tel_process import PAPER, wait_until

from tel_ros.app.view.graph import GraphView
from tel_ros.core.trial import Phase
from tel_ros.nodes import qos
from tel_ros.recording import topics
from tel_ros.recording.config_file import load_config


class MadeUpGraph:
    """A node that answers as the graph does, and a view of it."""

    def __init__(self, domain: int) -> None:
        self.context = Context()
        rclpy.init(context=self.context, domain_id=domain)
        self.node = Node("made_up", context=self.context)
        self.eyes = Node("eyes", context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        for node in (self.node, self.eyes):
            self.executor.add_node(node)
        self.asked: list[str] = []
        self.view = GraphView(self.eyes, load_config(PAPER), lambda goal: None, lambda feedback: None)

    def answer(self, success: bool = True, running: bool = True) -> None:
        """Offer the services that the buttons call."""

        def trigger(name: str) -> Callable[..., Trigger.Response]:
            def called(request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
                self.asked.append(name)
                response.success, response.message = success, "as asked" if success else "the arm moves"
                return response

            return called

        def cancel(request: CancelGoal.Request, response: CancelGoal.Response) -> CancelGoal.Response:
            anybody = not request.goal_info.goal_id.uuid.any() and request.goal_info.stamp.sec == 0
            self.asked.append("cancel whatever runs" if anybody else "cancel one")
            response.goals_canceling = [GoalInfo()] if running else []
            return response

        def pause(request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
            self.asked.append(f"pause {request.data}")
            response.success = True
            return response

        self.node.create_service(Trigger, topics.SAFETY_STOP, trigger("stop"))
        self.node.create_service(Trigger, topics.SAFETY_RESET, trigger("reset"))
        self.node.create_service(SetBool, topics.PAUSE, pause)
        self.node.create_service(CancelGoal, f"{topics.PRACTICE}/_action/cancel_goal", cancel)
        for client in self.eyes.clients:
            if client.srv_name in (topics.SAFETY_STOP, topics.SAFETY_RESET, topics.PAUSE) or (
                "cancel_goal" in client.srv_name
            ):
                self.wait_for(client.service_is_ready, client.srv_name)

    def wait_for(self, condition: Callable[[], bool], what: str) -> None:
        def spun() -> bool:
            self.executor.spin_once(timeout_sec=0.02)
            self.view.look_at_arm()
            self.view.look_at_controller()
            return condition()

        wait_until(spun, what)


@pytest.fixture
def made_up(domain: int) -> Iterator[MadeUpGraph]:
    graph = MadeUpGraph(domain)
    yield graph
    for node in (graph.node, graph.eyes):
        node.destroy_node()
    graph.context.try_shutdown()


def test_buttons_ask_for_what_they_say_and_show_the_answer(made_up: MadeUpGraph) -> None:
    made_up.answer()
    view = made_up.view
    for press, asked, said in (
        (view.emergency_stop, "stop", "emergency stop: as asked"),
        (view.reset, "reset", "reset: as asked"),
        (view.end_run, "cancel whatever runs", "stop: the run is ending"),
        (lambda: view.pause(True), "pause True", "pause: done"),
        (lambda: view.pause(False), "pause False", "go on: done"),
    ):
        press()
        made_up.wait_for(lambda said=said: view.answer == said, said)
        assert made_up.asked[-1] == asked
        assert not view.alarm


def test_a_stop_that_fails_sends_to_the_stop_by_wire(made_up: MadeUpGraph) -> None:
    view = made_up.view
    view.emergency_stop()  # nobody is there
    assert view.answer == "emergency stop: nobody offers /safety/stop; use the emergency stop by wire"
    assert view.alarm
    made_up.answer(success=False, running=False)
    view.emergency_stop()
    made_up.wait_for(lambda: "the arm moves" in view.answer, "the answer")
    assert view.answer.endswith("use the emergency stop by wire")
    assert view.alarm
    view.end_run()
    made_up.wait_for(lambda: "no run is under way" in view.answer, "the answer")
    view.reset()
    made_up.wait_for(lambda: view.answer == "reset: the arm moves", "the answer")


def test_a_stop_that_nobody_answers_is_said_to_have_had_no_answer(
    made_up: MadeUpGraph, monkeypatch: pytest.MonkeyPatch
) -> None:
    made_up.answer()
    made_up.executor.remove_node(made_up.node)  # it is there and hangs
    monkeypatch.setattr("tel_ros.app.view.graph.ANSWER_TIMEOUT_S", 0.2)
    made_up.view.emergency_stop()
    made_up.wait_for(lambda: "NO ANSWER" in made_up.view.answer, "the alarm")
    assert made_up.view.alarm
    assert "by wire" in made_up.view.answer


def test_the_view_samples_the_newest_states_and_has_no_publisher_of_its_own(made_up: MadeUpGraph) -> None:
    node, view = made_up.node, made_up.view
    joints = node.create_publisher(JointState, topics.JOINT_STATES, qos.STREAM)
    states = node.create_publisher(ControlState, topics.CONTROL_STATES, qos.STREAM)
    stopped = node.create_publisher(Bool, topics.SAFETY_STOPPED, qos.LATCHED)
    stopped.publish(Bool(data=True))
    made_up.wait_for(lambda: view.stopped and joints.get_subscription_count() == 1, "the connection")
    assert view.arm_age_s == np.inf
    control = ControlState(
        trial=3,
        phase=ControlState.RUN,
        time_from_start_s=1.5,
        desired_position_rad=[0.1, 0.2],
        position_rad=[0.3, 0.4],
        velocity_rad_s=[0.0, 0.0],
        effort_nm=[1.0, 2.0],
    )

    def heard() -> bool:
        names = list(reversed(load_config(PAPER).arm.joints))  # whatever the order
        joints.publish(JointState(name=names, position=[0.4, 0.3], velocity=[0.0, 0.0]))
        states.publish(control)
        return view.arm is not None and view.sample is not None

    made_up.wait_for(heard, "states")
    assert view.arm.position_rad.tolist() == [0.3, 0.4]
    assert (view.sample.trial, view.sample.phase) == (3, Phase.RUN)
    assert view.sample.desired_position_rad.tolist() == [0.1, 0.2]
    assert view.arm_age_s < 60.0
    own = {topic for topic, _ in made_up.node.get_publisher_names_and_types_by_node("eyes", "/")}
    assert own <= {"/rosout", "/parameter_events"}


def test_a_view_whose_terminal_is_closed_ends_and_leaves_nothing(tmp_path: Path) -> None:
    pytest.importorskip("viser", reason="needs the extra view")
    command = [sys.executable, "-m", "tel_ros.app.cli", "view", str(PAPER)]
    environment = {**os.environ, "TMPDIR": str(tmp_path)}
    # Under nohup, where whoever runs the tests may be, it would outlive its terminal.
    hears = partial(signal.signal, signal.SIGHUP, signal.SIG_DFL)
    with subprocess.Popen(
        command, env=environment, stdout=subprocess.PIPE, text=True, preexec_fn=hears
    ) as view:
        try:
            assert view.stdout is not None
            assert view.stdout.readline().startswith("view    http://")
            assert list(tmp_path.glob("tel_view_*"))
            view.send_signal(signal.SIGHUP)
            view.wait(timeout=30.0)
        finally:
            view.kill()
    assert (view.returncode, list(tmp_path.iterdir())) == (0, [])
