"""What a replay publishes, under which names, and when."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.typesys import Stores, get_typestore
from small_bags import MCAP, SQLITE3, STATES, TEXT, joint_state, text, write_bag
from synthetic_trial import SyntheticTrial

from tel_ros.core.errors import BagError, ConfigError
from tel_ros.core.types import NS_PER_S
from tel_ros.recording import topics
from tel_ros.recording.any_bag import open_any_bag
from tel_ros.recording.replay import STANDSTILL_S, Replay, ReplaySchedule

ROWS = [
    ("/mode", TEXT, 1 * NS_PER_S, text("fast")),
    ("/arm/joint_states", STATES, 2 * NS_PER_S, joint_state(2 * NS_PER_S, ["a"], [0.1])),
    ("/note", TEXT, 3 * NS_PER_S, text("first")),
    ("/arm/joint_states", STATES, 4 * NS_PER_S, joint_state(4 * NS_PER_S, ["a"], [0.2])),
    ("/note", TEXT, 5 * NS_PER_S, text("second")),
]


@contextmanager
def opened(bag: Path, **options: object) -> Iterator[Replay]:
    with open_any_bag(bag) as reader:
        yield Replay(reader, **options)


def names(bag: Path, **options: object) -> dict[str, str]:
    """Return recorded and published name of each topic."""
    with opened(bag, **options) as replay:
        return {topic.connection.topic: topic.name for topic in replay.topics}


def heard(bag: Path, **options: object) -> list[tuple[str, int, bytes]]:
    with opened(bag, **options) as replay:
        return [(t.connection.topic, time_ns, raw) for t, time_ns, raw in replay.messages(replay.topics)]


@pytest.mark.parametrize("states_to_nodes", [False, True])
def test_no_topic_of_a_replay_has_a_name_that_an_arm_listens_to(
    trial_bag: Path, tmp_path: Path, states_to_nodes: bool
) -> None:
    commands = [(topic, TEXT, 0, text("")) for topic in map(topics.absolute, topics.COMMANDS.values())]
    bags = [trial_bag, write_bag(tmp_path / "commands", [*ROWS, *commands])]
    for bag in bags:
        published = names(bag, states_to_nodes=states_to_nodes)
        assert set(map(topics.absolute, topics.COMMANDS.values())) & set(published)
        own = {name for name in published.values() if not name.startswith("/replay/")}
        assert own == ({topics.JOINT_STATES} if states_to_nodes else set())


def test_states_for_the_nodes_get_the_name_that_these_listen_to_whatever_it_was(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", ROWS)
    published = names(bag, states_to_nodes=True)
    assert published["/arm/joint_states"] == "joint_states"
    assert published["/note"] == "/replay/note"


def test_several_topics_of_states_are_not_guessed_from(tmp_path: Path) -> None:
    second = ("/other/joint_states", STATES, 0, joint_state(0, ["b"], [0.0]))
    bag = write_bag(tmp_path / "bag", [*ROWS, second])
    with pytest.raises(BagError, match="/arm/joint_states, /other/joint_states; expected exactly one"):
        names(bag, states_to_nodes=True)
    assert names(bag, states_to_nodes=True, patterns=("/other/*",)) == {"/other/joint_states": "joint_states"}
    with pytest.raises(BagError, match="joint states: none"):
        names(bag, states_to_nodes=True, patterns=("/note",))


def test_topics_are_chosen_by_name_and_by_pattern(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", ROWS)
    assert set(names(bag, patterns=("/arm/*", "/mode"))) == {"/arm/joint_states", "/mode"}
    with pytest.raises(BagError, match=r"no topic /elbow with messages.*/arm/joint_states, /mode, /note"):
        names(bag, patterns=("/arm/*", "/elbow"))


@pytest.mark.parametrize("storage", [MCAP, SQLITE3])
def test_messages_come_in_the_order_of_time_byte_by_byte(tmp_path: Path, storage: StoragePlugin) -> None:
    shuffled = [ROWS[4], ROWS[0], ROWS[3], ROWS[2], ROWS[1]]
    bag = write_bag(tmp_path / "bag", shuffled, storage)
    assert heard(bag) == [(topic, time_ns, raw) for topic, _, time_ns, raw in ROWS]


def test_the_goal_of_a_trial_comes_when_it_began_although_it_was_written_last(tmp_path: Path) -> None:
    trial = SyntheticTrial()
    found = heard(trial.write(tmp_path / "bag"))
    assert sorted(time_ns for _, time_ns, _ in found) == [time_ns for _, time_ns, _ in found]
    assert sorted(found) == sorted(trial.recorded())


@pytest.mark.parametrize("storage", [MCAP, SQLITE3])
def test_what_is_latched_holds_although_it_is_older_than_the_beginning(
    tmp_path: Path, storage: StoragePlugin
) -> None:
    bag = write_bag(tmp_path / "bag", ROWS, storage, latched=["/note"])
    with opened(bag) as replay:
        assert {t.connection.topic for t in replay.topics if t.latched} == {"/note", "/mode"}
    start_ns = 4 * NS_PER_S
    assert heard(bag, start_offset_s=3.0) == [
        ("/mode", start_ns, ROWS[0][3]),
        ("/note", start_ns, ROWS[2][3]),
        ("/arm/joint_states", start_ns, ROWS[3][3]),
        ("/note", 5 * NS_PER_S, ROWS[4][3]),
    ]


def test_an_offset_beyond_the_end_is_refused(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", ROWS)
    with pytest.raises(ConfigError, match=r"start-offset is 4.5; expected less than the bag's 4.000 s"):
        names(bag, start_offset_s=4.5)


@pytest.mark.parametrize("value", [0.0, -1.0, float("nan"), float("inf")])
def test_a_rate_that_is_none_is_refused(tmp_path: Path, value: float) -> None:
    with pytest.raises(ConfigError, match="rate is"):
        names(write_bag(tmp_path / "bag", ROWS), rate=value)


@pytest.mark.parametrize("value", [-0.1, float("nan"), float("inf")])
def test_an_offset_that_is_none_is_refused(tmp_path: Path, value: float) -> None:
    with pytest.raises(ConfigError, match="start-offset is"):
        names(write_bag(tmp_path / "bag", ROWS), start_offset_s=value)


def test_a_bag_of_ros_1_is_refused_with_the_way_out(tmp_path: Path) -> None:
    store, file = get_typestore(Stores.ROS1_NOETIC), tmp_path / "old.bag"
    with Writer1(file) as writer:
        connection = writer.add_connection("/note", TEXT, typestore=store)
        writer.write(connection, 1, store.serialize_ros1(store.types[TEXT](data="x"), TEXT))
    with pytest.raises(BagError, match="is a bag of ROS 1; expected a rosbag2 .rosbags-convert"):
        names(file)


def test_a_bag_without_messages_and_one_that_was_never_closed_are_refused(
    tmp_path: Path, trial_bag: Path
) -> None:
    with pytest.raises(BagError, match="holds no message"):
        names(write_bag(tmp_path / "empty", []))
    (trial_bag / "metadata.yaml").unlink()
    with pytest.raises(BagError, match="it was never closed"):
        names(trial_bag)
    with pytest.raises(BagError, match="there is no such file or folder"):
        names(tmp_path / "nothing")


def test_deadlines_are_absolute_and_follow_the_rate() -> None:
    schedule = ReplaySchedule(2.0, 10 * NS_PER_S, now_s=100.0)
    assert schedule.due_s(10 * NS_PER_S) == 100.0
    schedule.late(11 * NS_PER_S, 100.9)  # 0.4 s late, which moves nothing
    assert schedule.due_s(14 * NS_PER_S) == 102.0
    assert schedule.bag_ns(101.0) == 12 * NS_PER_S
    assert schedule.most_late_s == pytest.approx(0.4)
    assert schedule.stood_still_s == 0.0


def test_a_pause_moves_what_comes_after_it() -> None:
    schedule = ReplaySchedule(1.0, 0, now_s=0.0)
    schedule.set_paused(True, 2.0)
    schedule.set_paused(True, 3.0)
    assert schedule.paused
    assert schedule.bag_ns(50.0) == 2 * NS_PER_S
    schedule.set_paused(False, 12.0)
    schedule.set_paused(False, 13.0)
    assert not schedule.paused
    assert schedule.due_s(3 * NS_PER_S) == 13.0
    assert schedule.bag_ns(13.0) == 3 * NS_PER_S


def test_a_replay_that_was_held_up_goes_on_at_its_pace_instead_of_in_a_rush() -> None:
    schedule = ReplaySchedule(1.0, 0, now_s=0.0)
    schedule.late(1 * NS_PER_S, 1.0 + STANDSTILL_S + 4.0)
    assert schedule.due_s(2 * NS_PER_S) == pytest.approx(2.0 + STANDSTILL_S + 4.0)
    assert schedule.stood_still_s == pytest.approx(STANDSTILL_S + 4.0)
    assert schedule.most_late_s == 0.0
