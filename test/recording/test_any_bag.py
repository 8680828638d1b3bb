"""Bags as other programs and crashes leave them: the data count, whatever stands beside or around them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from mcap.writer import CompressionType, IndexType, Writer
from rosbags.rosbag2 import CompressionFormat, CompressionMode
from rosbags.rosbag2 import Writer as BagWriter
from small_bags import MCAP, SQLITE3, STATES, TEXT, joint_state, text, write_bag

from tel_ros.core.errors import BagError
from tel_ros.recording.any_bag import open_any_bag
from tel_ros.recording.bag_format import definition, typestore
from tel_ros.recording.bag_inspection import Wholeness, inspect_bag
from tel_ros.recording.joint_states import read_joint_states

N = 60
STATES_IN_ORDER = [
    (k * 10**7, joint_state(k * 10**7, ["a", "b"], [np.sin(k), 0.1 * k], [1.0, 2.0])) for k in range(1, N + 1)
]
ROWS = [("/joint_states", STATES, *row) for row in STATES_IN_ORDER] + [("/note", TEXT, 10**9, text("hello"))]

Order = Callable[[list[tuple[int, bytes]]], list[tuple[int, bytes]]]


def write_mcap(
    file: Path, profile: str = "ros2", order: Order = list, others: bool = True, **how: Any
) -> Path:
    """Write joint states, and beside them what nobody asks for: definitions, QoS and encodings."""
    with file.open("wb") as target:
        writer = Writer(target, **how)
        writer.start(profile=profile)
        kinds = [("/joint_states", STATES, "ros2msg", definition(STATES)[0].encode(), "")]
        if others:
            kinds += [
                ("/events", "pkg/srv/Go_Event", "ros2msg", b"what <<< is this", "- a: ["),
                ("/scene", "foxglove.Scene", "jsonschema", b"{}", "  "),
            ]
        channels = {
            topic: writer.register_channel(
                topic, "cdr", writer.register_schema(kind, encoding, data), {"offered_qos_profiles": qos}
            )
            for topic, kind, encoding, data, qos in kinds
        }
        for time_ns, raw in order(STATES_IN_ORDER):
            for topic, channel in channels.items():
                writer.add_message(channel, time_ns, raw if topic == "/joint_states" else b"{}", time_ns)
        writer.finish()
    return file


NONE = IndexType.NONE


@pytest.mark.parametrize("others", [False, True], ids=["alone", "with others"])
@pytest.mark.parametrize(
    "how",
    [
        {},
        {"profile": ""},
        {"index_types": NONE},
        {"index_types": NONE, "use_statistics": False},
        {"index_types": IndexType.CHUNK},
        {"index_types": IndexType.CHUNK, "use_statistics": False},
        {"index_types": IndexType.MESSAGE},
        {"use_statistics": False},
        {"repeat_channels": False},
        {"index_types": NONE, "use_statistics": False, "repeat_channels": False, "repeat_schemas": False},
        {"use_chunking": False},
        {"use_chunking": False, "order": lambda rows: rows[::-1]},
        {"index_types": NONE, "order": lambda rows: rows[::2] + rows[1::2]},
        {"compression": CompressionType.LZ4, "chunk_size": 2000},
    ],
)
def test_every_mcap_tells_all_of_its_messages(tmp_path: Path, how: dict[str, Any], others: bool) -> None:
    file = write_mcap(tmp_path / "bag.mcap", others=others, **how)
    inspected = inspect_bag(file)
    assert inspected.wholeness is Wholeness.COMPLETE
    assert {topic.name: topic.found for topic in inspected.topics}["/joint_states"] == N
    states = read_joint_states(file)
    assert states.topic == "/joint_states"
    np.testing.assert_allclose(states.position_rad[:, 1], 0.1 * np.arange(1, N + 1))
    with open_any_bag(file) as reader:
        times = [time_ns for c, time_ns, _ in reader.messages() if c.topic == "/joint_states"]
        assert times == [time_ns for time_ns, _ in STATES_IN_ORDER]
        assert (reader.start_time, reader.end_time - 1) == (times[0], times[-1])


def test_a_type_that_cannot_be_parsed_is_only_named_where_it_is_asked_for(tmp_path: Path) -> None:
    with open_any_bag(write_mcap(tmp_path / "bag.mcap")) as reader:
        (events,) = (c for c in reader.connections if c.topic == "/events")
        assert reader.definition(events)[0] == "what <<< is this"
        assert len(list(reader.messages([events]))) == N
        with pytest.raises(Exception, match="Could not parse"):
            reader.deserialize(b"{}", events.msgtype)


def change_metadata(bag: Path, change: Callable[[dict[str, Any]], Any]) -> Path:
    content = yaml.safe_load((bag / "metadata.yaml").read_text())
    change(content["rosbag2_bagfile_information"])
    (bag / "metadata.yaml").write_text(yaml.safe_dump(content))
    return bag


def each_topic(**values: Any) -> Callable[[dict[str, Any]], Any]:
    return lambda told: [each["topic_metadata"].update(values) for each in told["topics_with_message_count"]]


@pytest.mark.parametrize("storage", [MCAP, SQLITE3])
@pytest.mark.parametrize(
    "change",
    [
        each_topic(offered_qos_profiles=""),
        each_topic(offered_qos_profiles="- a: ["),
        each_topic(type="", serialization_format=""),
        each_topic(name=None),
        lambda told: told.update(topics_with_message_count=None),
        lambda told: [each.update(message_count=None) for each in told["topics_with_message_count"]],
        lambda told: told.update(relative_file_paths=None, files=None),
        lambda told: told.update(relative_file_paths=["as_it_was_called_0.mcap"]),
        lambda told: told.update(duration=None, starting_time=None, storage_identifier="", version=None),
        lambda told: told.update(compression_format="zstd", compression_mode="FILE", custom_data="words"),
        lambda told: told.clear(),
    ],
)
def test_metadata_that_say_less_or_nonsense_do_not_matter(
    tmp_path: Path, storage: Any, change: Callable[[dict[str, Any]], Any]
) -> None:
    bag = change_metadata(write_bag(tmp_path / "bag", ROWS, storage), change)
    inspected = inspect_bag(bag)
    assert (inspected.wholeness, inspected.n_messages) == (Wholeness.COMPLETE, N + 1)
    assert len(read_joint_states(bag).time_s) == N


@pytest.mark.parametrize("content", ["", "words", "a: [", "\x00"])
def test_metadata_that_cannot_be_read_do_not_matter(tmp_path: Path, content: str) -> None:
    bag = write_bag(tmp_path / "bag", ROWS)
    (bag / "metadata.yaml").write_text(content)
    assert inspect_bag(bag).n_messages == N + 1


def test_what_is_announced_and_missing_matters(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", ROWS)
    change_metadata(bag, lambda told: told["topics_with_message_count"][0].update(message_count=N + 7))
    inspected = inspect_bag(bag)
    assert inspected.wholeness is Wholeness.BROKEN
    assert f"{N} messages of /joint_states instead of {N + 7}" in inspected.problem
    change_metadata(bag, lambda told: told.update(relative_file_paths=["bag.mcap", "bag_1.mcap"]))
    with pytest.raises(BagError, match="has no bag_1.mcap, which its metadata.yaml names"):
        read_joint_states(bag)


@pytest.mark.parametrize("storage", [MCAP, SQLITE3])
@pytest.mark.parametrize("mode", [CompressionMode.FILE, CompressionMode.MESSAGE])
@pytest.mark.parametrize("with_metadata", [True, False])
def test_compressed_bags_are_read_with_and_without_metadata(
    tmp_path: Path, storage: Any, mode: CompressionMode, with_metadata: bool
) -> None:
    writer = BagWriter(tmp_path / "bag", version=9, storage_plugin=storage)
    writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        connection = writer.add_connection("/joint_states", STATES, typestore=typestore())
        for time_ns, raw in STATES_IN_ORDER:
            writer.write(connection, time_ns, raw)
    if not with_metadata:
        (tmp_path / "bag" / "metadata.yaml").unlink()
    with open_any_bag(tmp_path / "bag", closed=False) as reader:
        assert [(time_ns, raw) for _, time_ns, raw in reader.messages()] == STATES_IN_ORDER


@pytest.mark.parametrize(
    ("what", "said"),
    [
        ("config.yaml", "is a YAML file"),
        ("network.npz", "is a network file"),
        ("data.csv", "is a CSV"),
        ("run", "is the folder of a practice run, which holds a bag a trial"),
        ("nowhere", "there is no such file or folder"),
        ("", "is a folder without metadata.yaml and data files: no bag"),
    ],
)
def test_what_is_no_bag_is_called_what_it_is(tmp_path: Path, what: str, said: str) -> None:
    for name in ("config.yaml", "network.npz", "data.csv"):
        (tmp_path / name).write_text("x")
    (tmp_path / "run" / "trial_001").mkdir(parents=True)
    (tmp_path / "run" / "run.yaml").write_text("x")
    with pytest.raises(BagError) as caught, open_any_bag(tmp_path / what):
        pass
    assert said in str(caught.value)
    assert "expected a closed rosbag2 folder, an .mcap, .db3 or .bag file" in str(caught.value)
