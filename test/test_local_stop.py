"""The emergency stop on the same computer, without ROS: who is found, and what is answered."""

from __future__ import annotations

import os
import time
from functools import partial
from itertools import count
from threading import Event, Thread

import pytest

from tel_ros import local_stop
from tel_ros.core.errors import ConfigError
from tel_ros.local_stop import RESET, STOP, Answer, Controller, Listener, ask, controllers

LONG = "/" + "/".join(["a_namespace_of_many_letters"] * 5)
_numbers = count(1_000)


@pytest.fixture
def domain() -> int:
    """Return a domain that nobody has, not even beside this process."""
    return 1_000_000 * os.getpid() + next(_numbers)


def test_each_controller_is_found_by_domain_and_namespace(domain: int) -> None:
    spaces = ("/", "/left", "/left/lower", LONG)
    listeners = [Listener(Controller(domain, n, space), {}) for n, space in enumerate(spaces)]
    found = sorted((each for each in controllers() if each.domain == domain), key=lambda each: each.pid)
    assert [each.pid for each in found] == [0, 1, 2, 3]
    assert [each.namespace for each in found][:3] == ["/", "/left", "/left/lower"]
    for space in (*spaces, "/right"):
        assert [each.pid for each in found if each.is_in(space)] == [
            n for n, s in enumerate(spaces) if s == space
        ]
    del listeners
    assert not [each for each in controllers() if each.domain == domain]


def test_a_request_is_done_and_answered_and_anything_else_is_not(domain: int) -> None:
    done: list[str] = []

    def answer(request: str, answer: Answer) -> Answer:
        done.append(request)
        return answer

    me, over = Controller(domain, 1, "/"), Event()
    listener = Listener(
        me,
        {
            STOP: lambda: answer(STOP, Answer(True, "stopped until reset")),
            RESET: lambda: answer(RESET, Answer(False, "not reset: the arm moves")),
        },
    )
    listener.serve()
    assert done == []

    def serve() -> None:
        while not over.wait(0.001):
            listener.serve()

    thread = Thread(target=serve)
    thread.start()
    try:
        assert ask([me], STOP)[me] == Answer(True, "stopped until reset")
        assert ask([me], RESET)[me] == Answer(False, "not reset: the arm moves")
    finally:
        over.set()
        thread.join()
    assert done == [STOP, RESET]


def test_a_controller_that_hangs_or_is_gone_gives_no_answer(
    domain: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(local_stop, "ANSWER_TIMEOUT_S", 0.05)
    me = Controller(domain, 1, "/")
    listener = Listener(me, {STOP: lambda: Answer(True, "")})
    assert ask([me], STOP) == {me: None}  # nobody serves
    listener.serve()  # late, and whoever has asked is gone
    del listener
    assert ask([me], STOP) == {me: None}


def test_a_controller_that_hangs_does_not_keep_the_others_from_stopping(
    domain: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(local_stop, "ANSWER_TIMEOUT_S", 60.0)
    stopped, answers = [Event(), Event()], {}
    both = [Controller(domain, n, "/") for n in range(2)]

    def stop(n: int) -> Answer:
        stopped[n].set()
        return Answer(True, f"{n} stopped")

    hangs, lives = (Listener(each, {STOP: partial(stop, n)}) for n, each in enumerate(both))
    thread = Thread(target=lambda: answers.update(ask(both, STOP)))
    thread.start()
    for n, each in ((1, lives), (0, hangs)):
        end = time.monotonic() + 20.0
        while not stopped[n].wait(0.001) and time.monotonic() < end:
            each.serve()
        assert stopped[n].is_set()
    thread.join(20.0)
    assert answers == {both[0]: Answer(True, "0 stopped"), both[1]: Answer(True, "1 stopped")}


@pytest.mark.parametrize(("value", "domain"), [("", 0), ("0", 0), (" 5", 5), ("0x10", 16), ("232", 232)])
def test_a_domain_is_read_as_ros_reads_it(monkeypatch: pytest.MonkeyPatch, value: str, domain: int) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", value)
    assert local_stop.domain_id() == domain


@pytest.mark.parametrize("value", ["abc", "233", "-1", "1.0", "0x100", "7 8"])
def test_what_is_no_domain_is_refused(monkeypatch: pytest.MonkeyPatch, value: str) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", value)
    with pytest.raises(ConfigError, match=f"ROS_DOMAIN_ID is '{value}'; expected a number from 0 to 232"):
        local_stop.domain_id()
