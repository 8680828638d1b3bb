"""Asking a service whose answer may be lost."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest
from rclpy.task import Future
from tel_interfaces.action import Practice

from tel_ros.nodes import waiting
from tel_ros.nodes.waiting import NoAnswerError, SilenceError, ask, send_goal


class Service:
    """A service whose first answers get lost, and its client."""

    service_name = "/service"

    def __init__(self, lost: int) -> None:
        self.lost, self.asked, self.given_up = lost, 0, 0

    def service_is_ready(self) -> bool:
        return True

    def call_async(self, request: str) -> Future:
        self.asked += 1
        future = Future()
        if self.asked > self.lost:
            future.set_result(f"answer to {request}")
        return future

    def remove_pending_request(self, future: Future) -> None:
        self.given_up += 1


def test_a_request_whose_answer_is_lost_is_made_again() -> None:
    service = Service(lost=2)
    assert ask(service, "question", 30.0, again_s=0.1) == "answer to question"
    assert (service.asked, service.given_up) == (3, 2)


def test_what_must_not_be_done_twice_is_asked_once() -> None:
    service = Service(lost=1)
    with pytest.raises(SilenceError, match=r"/service did not answer within 0\.2 s"):
        ask(service, "question", 0.2)
    assert service.asked == 1


def test_silence_ends_after_the_whole_time() -> None:
    service = Service(lost=1000)
    with pytest.raises(SilenceError):
        ask(service, "question", 0.5, again_s=0.1)
    assert 1 < service.asked < 10


def test_who_gives_up_meanwhile_does_not_ask_again() -> None:
    def give_up() -> None:
        raise NoAnswerError("ended from outside")

    service = Service(lost=1000)
    with pytest.raises(NoAnswerError, match="ended from outside"):
        ask(service, "question", 30.0, give_up, again_s=0.1)
    assert service.asked == 1


class DeafServer:
    """An action whose answer to a goal gets lost, and its client."""

    def send_goal_async(self, goal: Practice.Goal, feedback_callback: Callable[[Any], None]) -> Future:
        self.tell = feedback_callback
        return Future()


def test_feedback_on_a_goal_whose_answer_is_lost_tells_that_it_was_accepted(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    server, heard = DeafServer(), []
    sent = send_goal(server, Practice, Practice.Goal(), heard.append)
    server.tell(SimpleNamespace(goal_id="the goal", feedback="at once"))
    assert not sent.done(), "the answer may still be on its way"
    monkeypatch.setattr(waiting, "LOST_S", 0.0)
    server.tell(SimpleNamespace(goal_id="the goal", feedback="later"))
    handle = sent.result()
    assert handle.accepted
    assert handle.goal_id == "the goal"
    assert heard == ["at once", "later"]
