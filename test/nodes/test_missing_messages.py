"""Messages that did not arrive show in the stamps of those that did."""

from __future__ import annotations

import pytest

from tel_ros.nodes.trial_recorder import COMMANDS, missing
from tel_ros.recording import topics

STAMPS = list(range(0, 100, 2))


def recorded(**changed: list[int]) -> dict[str, list[int]]:
    stamps = {"states": [*STAMPS, 100], "ticks": STAMPS, "commands": STAMPS} | changed
    names = {
        "states": topics.JOINT_STATES,
        "ticks": topics.CONTROL_STATES,
        "commands": topics.POSITION_COMMANDS,
    }
    return {names[name]: values for name, values in stamps.items()}


def test_a_whole_recording_lacks_nothing() -> None:
    assert missing(recorded()) == {}


@pytest.mark.parametrize(("name", "topic"), [("states", topics.JOINT_STATES), ("commands", COMMANDS)])
def test_each_message_that_did_not_arrive_is_counted(name: str, topic: str) -> None:
    assert missing(recorded(**{name: [s for s in STAMPS if s not in (10, 12, 60)]})) == {topic: 3}
    assert missing(recorded(**{name: STAMPS[:-5]})) == {topic: 5}


def test_a_topic_that_nothing_came_from_lacks_everything() -> None:
    assert missing(recorded(commands=[])) == {COMMANDS: len(STAMPS)}


def test_what_came_before_the_recording_began_is_not_missed() -> None:
    """An arm in lockstep has published the state that the first tick answers before anybody recorded."""
    assert missing(recorded(states=STAMPS[1:], commands=STAMPS[2:])) == {}


def test_stamps_that_jump_back_are_no_gap() -> None:
    jumped = [*STAMPS[:20], *(s - 1000 for s in STAMPS[20:])]
    assert missing(recorded(states=jumped, ticks=jumped, commands=jumped)) == {}


def test_commands_of_either_topic_count() -> None:
    stamps = recorded(commands=STAMPS[:20]) | {topics.EFFORT_COMMANDS: STAMPS[20:]}
    assert missing(stamps) == {}
