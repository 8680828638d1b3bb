"""A node that does not answer any more is noticed; one that is slow is left alone."""

from __future__ import annotations

import pytest
from rclpy.task import Future

from tel_ros.app.errors import GraphError
from tel_ros.app.practice import ASK_PERIOD_S, SILENCE_TIMEOUT_S, Liveness


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


@pytest.fixture
def asked() -> Asked:
    return Asked()


@pytest.fixture
def liveness(asked: Asked) -> Liveness:
    return Liveness(asked, "practice_manager", asked.clock)


def later(asked: Asked, seconds: float) -> None:
    asked.now_s += seconds


def test_a_node_that_answers_is_asked_again_and_again(asked: Asked, liveness: Liveness) -> None:
    for _ in range(50):
        later(asked, ASK_PERIOD_S + 0.1)
        liveness.check()
        asked.requests[-1].set_result(None)
    assert asked.name == "practice_manager/get_parameters"
    assert len(asked.requests) == 50


def test_a_node_that_does_not_answer_is_named(asked: Asked, liveness: Liveness) -> None:
    later(asked, ASK_PERIOD_S + 0.1)
    liveness.check()
    later(asked, SILENCE_TIMEOUT_S + 1.0)
    with pytest.raises(GraphError, match="node practice_manager has not answered for 21 s"):
        liveness.check()


def test_a_slow_answer_is_an_answer(asked: Asked, liveness: Liveness) -> None:
    for _ in range(5):
        later(asked, ASK_PERIOD_S + 0.1)
        liveness.check()
        later(asked, SILENCE_TIMEOUT_S - 1.0)
        liveness.check()
        asked.requests[-1].set_result(None)
    assert len(asked.requests) == 5


def test_a_long_pause_of_the_asking_side_is_no_silence_of_the_other(asked: Asked, liveness: Liveness) -> None:
    later(asked, 10 * SILENCE_TIMEOUT_S)
    liveness.check()
    assert len(asked.requests) == 1


def test_a_node_that_is_not_there_yet_is_not_asked(asked: Asked, liveness: Liveness) -> None:
    asked.ready = False
    later(asked, 10 * SILENCE_TIMEOUT_S)
    liveness.check()
    assert asked.requests == []
