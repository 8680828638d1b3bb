"""A run that is paused, watched, and stopped from the page."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator

import pytest
import rclpy
from graph_harness import PAPER, QUICK, TelProcess, summary_of, wait_until
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from std_srvs.srv import SetBool
from tel_interfaces.action import Practice

from tel_ros.app.view.graph import GraphView
from tel_ros.nodes import qos
from tel_ros.recording import topics
from tel_ros.recording.config_file import load_config

pytestmark = pytest.mark.timeout(400)


class Person:
    """Somebody with a terminal: calls services, and hears how the run goes."""

    def __init__(self, domain: int) -> None:
        self.context = Context()
        rclpy.init(context=self.context, domain_id=domain)
        self.node = Node("person", context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.stages: list[tuple[int, str]] = []
        self.told: list[int] = []
        self.node.create_subscription(
            Practice.Impl.FeedbackMessage, f"{topics.PRACTICE}/_action/feedback", self._hear, qos.EVENTS
        )

    def _hear(self, message: Practice.Impl.FeedbackMessage) -> None:
        self.stages.append((message.feedback.trial, message.feedback.stage))
        self.told += [result.index for result in message.feedback.last]

    def call(self, kind: type, name: str, request: object) -> object:
        client = self.node.create_client(kind, name)
        assert client.wait_for_service(60.0)
        answer = client.call_async(request)
        self.executor.spin_until_future_complete(answer, 30.0)
        return answer.result()

    def wait_for(self, condition: Callable[[], bool], what: str) -> None:
        def spun() -> bool:
            self.executor.spin_once(timeout_sec=0.05)
            return condition()

        wait_until(spun, 90.0, what)


@pytest.fixture
def person(domain: int) -> Iterator[Person]:
    made = Person(domain)
    yield made
    made.node.destroy_node()
    made.context.try_shutdown()


def test_a_pause_holds_the_run_before_its_next_trial_until_it_is_taken_back(
    tel: Callable[..., TelProcess], person: Person
) -> None:
    run, goals = tel(*QUICK), []
    assert person.call(SetBool, topics.PAUSE, SetBool.Request(data=True)).success
    person.wait_for(lambda: any(stage == "paused" for _, stage in person.stages), "the pause")
    paused_after = person.stages[-1][0]
    log = run.folder / "log" / "ep_controller.log"
    assert f"trial {paused_after + 1}: " not in log.read_text()
    assert person.call(SetBool, topics.PAUSE, SetBool.Request(data=False)).success
    person.wait_for(lambda: person.stages[-1][1] != "paused", "the next trial")
    person.call(SetBool, topics.PAUSE, SetBool.Request(data=True))
    person.wait_for(lambda: person.stages[-1][1] == "paused", "the second pause")
    # A run that waits can be ended, as the page's button does it.
    view = GraphView(person.node, load_config(PAPER), goals.append, lambda feedback: None)
    person.wait_for(lambda: bool(goals) and view.paused, "what the view listens to")
    view.end_run()
    person.wait_for(lambda: view.look_at_arm() or bool(view.answer), "the answer")
    assert view.answer == "stop: the run is ending"
    code, out, _ = run.finish()
    summary = summary_of(out)
    assert (code, summary["outcome"]) == (1, "cancelled")
    told = [trial["index"] for trial in summary["trials"]]
    assert person.told == told  # each once, pauses or not


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
