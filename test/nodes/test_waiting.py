"""Asking nodes whose answers may be lost."""

from __future__ import annotations

import threading
from typing import Any
from unittest.mock import MagicMock

import pytest
from rclpy.action import client as client_module
from rclpy.task import Future
from tel_interfaces.action import Practice

from tel_ros.nodes.waiting import (
    AGAIN_S,
    ASK_PERIOD_S,
    Liveness,
    LockedActionClient,
    NoAnswerError,
    SilenceError,
    ask,
)


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


class Asked:
    """Stands for the node that asks, for its client, and for the clock."""

    def __init__(self) -> None:
        self.now_s, self.ready, self.requests = 0.0, True, []

    def create_client(self, kind: type, name: str) -> Asked:
        self.name = name
        return self

    def service_is_ready(self) -> bool:
        return self.ready

    def call_async(self, request: object) -> Future:
        self.requests.append(Future())
        return self.requests[-1]

    def clock(self) -> float:
        return self.now_s

    def later(self, seconds: float) -> None:
        self.now_s += seconds


@pytest.fixture
def asked() -> Asked:
    return Asked()


@pytest.fixture
def liveness(asked: Asked) -> Liveness:
    return Liveness(asked, "practice_manager", asked.clock)


def test_a_node_whose_first_answers_are_lost_is_asked_until_it_has_answered_one(
    asked: Asked, liveness: Liveness
) -> None:
    for _ in range(3):
        liveness.ask()
        liveness.ask()  # not yet again
        asked.later(AGAIN_S + 0.1)
        assert not liveness.met
    asked.requests[-1].set_result(None)
    assert liveness.met
    assert len(asked.requests) == 3
    assert liveness.ask() == 0.0


def test_a_node_that_answers_is_asked_again_and_again(asked: Asked, liveness: Liveness) -> None:
    for _ in range(50):
        asked.later(ASK_PERIOD_S + 0.1)
        assert liveness.ask() == 0.0
        asked.requests[-1].set_result(None)
    assert asked.name == "practice_manager/get_parameters"
    assert len(asked.requests) == 50


def test_silence_counts_from_the_first_question_without_an_answer_and_ends_with_any(
    asked: Asked, liveness: Liveness
) -> None:
    liveness.ask()
    for _ in range(5):
        asked.later(4.0)
        silence_s = liveness.ask()
    assert silence_s == 20.0
    asked.requests[-2].set_result(None)
    assert liveness.ask() == 0.0


def test_a_long_pause_of_the_asking_side_is_no_silence_of_the_other(asked: Asked, liveness: Liveness) -> None:
    liveness.ask()
    asked.requests[-1].set_result(None)
    asked.later(1000.0)
    assert liveness.ask() == 0.0
    assert len(asked.requests) == 2


def test_a_node_that_is_not_there_yet_is_not_asked(asked: Asked, liveness: Liveness) -> None:
    asked.ready = False
    asked.later(1000.0)
    assert liveness.ask() == 0.0
    assert asked.requests == []


class Handle:
    """An action's server that answers before the sending has returned, while another thread takes answers."""

    def send_goal_request(self, request: Any) -> int:
        self.taking = threading.Thread(target=lambda: setattr(self, "taken", self.client.take_data()))
        self.taking.start()
        self.taking.join(0.2)
        return 1

    def is_ready(self, wait_set: object) -> tuple[bool, ...]:
        return False, False, True, False, False

    def take_goal_response(self, kind: type) -> tuple[int, Any]:
        self.known = dict(self.client._pending_goal_requests)
        return 1, kind(accepted=True)


def test_an_answer_that_another_thread_takes_at_once_is_not_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    handle = Handle()
    monkeypatch.setattr(client_module, "check_for_type_support", lambda kind: None)
    monkeypatch.setattr(client_module._rclpy, "ActionClient", lambda *args: handle)
    handle.client = LockedActionClient(MagicMock(), Practice, "practice")
    handle.client.is_ready(None)
    sent = handle.client.send_goal_async(Practice.Goal())
    handle.taking.join()
    assert handle.known == {1: sent}
    assert handle.taken["goal"][1].accepted
