"""Bags of other people, in every form that rosbag has had."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from sqlite3 import connect
from typing import Any

import numpy as np
import pytest
from made_up_recording import made_up
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

from tel_ros.core.errors import InputFileError
from tel_ros.recording.foreign.recordings import (
    JOINT_STATE,
    JOINT_TRAJECTORY,
    Wanted,
    read_bag,
    read_source,
    read_sources,
)

RECORDING = made_up(1.0, 100.0).recording
NAMES = list(RECORDING.joints)
STORE = get_typestore(Stores.ROS2_JAZZY)
STORE_1 = get_typestore(Stores.ROS1_NOETIC)
FIRST_NS = 1_700_000_000 * 10**9
TIME_NS = FIRST_NS + np.round(1e9 * RECORDING.time_s).astype(np.int64)


def state(k: int, names: Sequence[str] = NAMES, effort: bool = True, stamped: bool = True) -> Any:
    """Return the joint state of a sample in the form of ROS 2."""
    stamp_ns = int(TIME_NS[k]) if stamped else 0
    columns = [RECORDING.joints.index(name) for name in names]
    return STORE.types[JOINT_STATE](
        header=STORE.types["std_msgs/msg/Header"](
            STORE.types["builtin_interfaces/msg/Time"](stamp_ns // 10**9, stamp_ns % 10**9), ""
        ),
        name=list(names),
        position=RECORDING.position_rad[k, columns],
        velocity=np.empty(0),
        effort=RECORDING.effort_nm[k, columns] if effort else np.empty(0),
    )


def write(bag: Path, topics: dict[str, list[Any]], storage: StoragePlugin = StoragePlugin.MCAP) -> Path:
    """Write messages at the times of the samples."""
    with Writer2(bag, version=9, storage_plugin=storage) as writer:
        for topic, messages in topics.items():
            kind = messages[0].__msgtype__ if messages else JOINT_STATE
            connection = writer.add_connection(topic, kind, typestore=STORE)
            for k, message in enumerate(messages):
                writer.write(connection, int(TIME_NS[k]), STORE.serialize_cdr(message, kind))
    return bag


def states(**options: Any) -> list[Any]:
    return [state(k, **options) for k in range(len(TIME_NS))]


def mcap(folder: Path) -> Path:
    return write(folder / "mcap", {"/joint_states": states()})


def sqlite3(folder: Path) -> Path:
    return write(folder / "sqlite3", {"/joint_states": states()}, StoragePlugin.SQLITE3)


def without_metadata(write_bag: Callable[[Path], Path]) -> Callable[[Path], Path]:
    def written(folder: Path) -> Path:
        bag = write_bag(folder)
        (bag / "metadata.yaml").unlink()
        return bag

    return written


def data_file(write_bag: Callable[[Path], Path]) -> Callable[[Path], Path]:
    return lambda folder: next(f for f in write_bag(folder).iterdir() if f.suffix != ".yaml")


def rosbag1(folder: Path) -> Path:
    bag = folder / "recording.bag"
    header, kind = STORE_1.types["std_msgs/msg/Header"], STORE_1.types[JOINT_STATE]
    with Writer1(bag) as writer:
        connection = writer.add_connection("/joint_states", JOINT_STATE, typestore=STORE_1)
        for k, time_ns in enumerate(TIME_NS.tolist()):
            it = state(k)
            stamp = STORE_1.types["builtin_interfaces/msg/Time"](it.header.stamp.sec, it.header.stamp.nanosec)
            message = kind(header(k, stamp, ""), it.name, it.position, it.velocity, it.effort)
            writer.write(connection, time_ns, STORE_1.serialize_ros1(message, JOINT_STATE))
    return bag


@pytest.mark.parametrize(
    "make",
    [
        mcap,
        sqlite3,
        without_metadata(mcap),
        without_metadata(sqlite3),
        data_file(mcap),
        data_file(sqlite3),
        rosbag1,
    ],
    ids=["mcap", "sqlite3", "mcap, no metadata", "sqlite3, no metadata", "mcap file", "db3 file", "rosbag1"],
)
def test_every_form_of_a_bag_tells_the_same(tmp_path: Path, make: Callable[[Path], Path]) -> None:
    (found,) = read_source(make(tmp_path))
    assert found.joints == RECORDING.joints
    np.testing.assert_allclose(found.time_s, RECORDING.time_s, atol=1e-9)
    np.testing.assert_array_equal(found.position_rad, RECORDING.position_rad)
    np.testing.assert_array_equal(found.effort_nm, RECORDING.effort_nm)


def test_messages_may_name_the_joints_in_any_order(tmp_path: Path) -> None:
    mixed = [state(k, NAMES if k % 3 else NAMES[::-1]) for k in range(len(TIME_NS))]
    (found,) = read_bag(
        write(tmp_path / "bag", {"/joint_states": mixed}),
        Wanted(
            joints=(
                "shoulder",
                "elbow",
            )
        ),
    )
    np.testing.assert_array_equal(found.of(RECORDING.joints).position_rad, RECORDING.position_rad)


def test_messages_of_other_joints_on_the_same_topic_are_passed_over(tmp_path: Path) -> None:
    mixed = [state(k, NAMES if k % 4 else ["elbow"]) for k in range(len(TIME_NS))]
    (found,) = read_bag(write(tmp_path / "bag", {"/joint_states": mixed}))
    assert found.joints == RECORDING.joints
    assert len(found.time_s) == 75


def test_stamps_that_nobody_set_are_those_of_the_recorder(tmp_path: Path) -> None:
    (found,) = read_bag(write(tmp_path / "bag", {"/joint_states": states(stamped=False)}))
    np.testing.assert_allclose(found.time_s, RECORDING.time_s, atol=1e-9)


def trajectory(effort: bool = True) -> Any:
    point = STORE.types["trajectory_msgs/msg/JointTrajectoryPoint"]
    duration = STORE.types["builtin_interfaces/msg/Duration"]
    none = np.empty(0)
    return STORE.types[JOINT_TRAJECTORY](
        header=state(0).header,
        joint_names=NAMES,
        points=[
            point(
                positions=RECORDING.position_rad[k],
                velocities=none,
                accelerations=none,
                effort=RECORDING.effort_nm[k] if effort else none,
                time_from_start=duration(0, int(TIME_NS[k] - FIRST_NS)),
            )
            for k in range(len(TIME_NS))
        ],
    )


def test_each_trajectory_with_efforts_is_a_recording(tmp_path: Path) -> None:
    bag = write(
        tmp_path / "bag", {"/executed": [trajectory(), trajectory()], "/joint_states": states(effort=False)}
    )
    first, second = read_bag(bag)
    for found in (first, second):
        np.testing.assert_allclose(found.time_s, RECORDING.time_s, atol=1e-9)
        np.testing.assert_array_equal(found.effort_nm, RECORDING.effort_nm)


def refusal(*arguments: Any, **options: Any) -> str:
    with pytest.raises(InputFileError) as caught:
        read_bag(*arguments, **options)
    text = str(caught.value)
    assert text.startswith(str(arguments[0]))
    assert "\n" not in text
    return text


def test_no_effort_is_refused(tmp_path: Path) -> None:
    bag = write(tmp_path / "bag", {"/joint_states": states(effort=False)})
    assert "no effort on /joint_states; expected efforts in N·m" in refusal(bag)


def test_joints_that_nobody_recorded_are_refused(tmp_path: Path) -> None:
    assert "no effort on /joint_states for wrist" in refusal(mcap(tmp_path), Wanted(joints=("wrist",)))


def test_an_empty_bag_is_refused(tmp_path: Path) -> None:
    assert "it is empty" in refusal(write(tmp_path / "empty", {"/joint_states": []}))


def test_a_bag_without_joints_is_refused_with_what_it_has(tmp_path: Path) -> None:
    text = STORE.types["std_msgs/msg/String"]("hello")
    found = refusal(write(tmp_path / "bag", {"/chatter": [text]}))
    assert "/chatter (std_msgs/msg/String)" in found
    assert "JointState" in found


def test_two_topics_with_efforts_ask_for_a_choice(tmp_path: Path) -> None:
    bag = write(tmp_path / "bag", {"/left": states(), "/right": states()})
    assert "/left, /right; expected one of them as --topic" in refusal(bag)
    assert "has no topic /middle" in refusal(bag, Wanted(topic="/middle"))
    assert read_bag(bag, Wanted(topic="/right"))[0].source.endswith("/right")


def test_a_file_that_the_metadata_names_and_that_is_gone_is_named(tmp_path: Path) -> None:
    bag = mcap(tmp_path)
    (bag / "mcap.mcap").unlink()
    assert "mcap.mcap" in refusal(bag)


def test_another_serialisation_is_refused(tmp_path: Path) -> None:
    bag = sqlite3(tmp_path)
    with closing(connect(bag / "sqlite3.db3")) as database, database:
        database.execute("UPDATE topics SET serialization_format = 'protobuf'")
    assert "has /joint_states serialised as 'protobuf'" in refusal(bag)


def test_messages_that_are_announced_and_missing_are_noticed(tmp_path: Path) -> None:
    bag = sqlite3(tmp_path)
    metadata = (bag / "metadata.yaml").read_text()
    (bag / "metadata.yaml").write_text(metadata.replace("message_count: 100", "message_count: 120"))
    assert "yields 100 messages of /joint_states; expected the 120" in refusal(bag)


@pytest.mark.parametrize("damage", [b"", b"not a bag at all", b"\x89MCAP0\r\n"])
def test_damaged_files_are_refused_in_one_line(tmp_path: Path, damage: bytes) -> None:
    for name in ("a.mcap", "b.db3", "c.bag"):
        (tmp_path / name).write_bytes(damage)
        refusal(tmp_path / name)


def test_what_is_not_there_or_no_bag_is_refused(tmp_path: Path) -> None:
    assert "no such file or folder" in refusal(tmp_path / "nowhere")
    assert "is a folder without metadata.yaml and data files" in refusal(tmp_path)
    (tmp_path / "notes.txt").write_text("hello")
    with pytest.raises(InputFileError, match=r"is a .txt file; expected .*\.bag, \.mcap, \.db3, \.csv"):
        read_source(tmp_path / "notes.txt")


def test_a_message_with_a_value_too_few_is_named(tmp_path: Path) -> None:
    messages = states()
    messages[7] = replace(messages[7], effort=messages[7].effort[:1])
    assert "message 8 has 1 value in effort" in refusal(write(tmp_path / "bag", {"/joint_states": messages}))


def test_several_sources_are_read_in_the_same_order_of_joints(tmp_path: Path) -> None:
    bag = write(tmp_path / "bag", {"/joint_states": [state(k, NAMES[::-1]) for k in range(len(TIME_NS))]})
    csv = tmp_path / "recording.csv"
    values = np.column_stack([RECORDING.time_s, RECORDING.position_rad, RECORDING.effort_nm])
    header = "time_s,q_shoulder,q_elbow,tau_shoulder,tau_elbow"
    np.savetxt(csv, values, delimiter=",", header=header, comments="")
    found, others, _ = read_sources([bag, csv])
    assert [recording.joints for recording in found] == [("elbow", "shoulder")] * 2
    for recording in found:
        np.testing.assert_allclose(recording.effort_nm, RECORDING.effort_nm[:, ::-1])
    assert others == {}


def test_joints_that_are_not_learned_tell_where_they_were(tmp_path: Path) -> None:
    found, others, _ = read_sources([mcap(tmp_path)], Wanted(joints=("elbow",)))
    assert found[0].joints == ("elbow",)
    (joint, (low, high)), *rest = others.items()
    assert (joint, rest) == ("shoulder", [])
    assert (low, high) == (RECORDING.position_rad[:, 0].min(), RECORDING.position_rad[:, 0].max())


def test_what_cannot_be_learned_from_is_refused_with_its_source(tmp_path: Path) -> None:
    still = [replace(s, position=s.position * [1.0, 0.0] + [0.0, 0.3]) for s in states()]
    with pytest.raises(InputFileError, match="bag: /joint_states: elbow stands still at 0.3 rad"):
        read_sources([write(tmp_path / "bag", {"/joint_states": still})])
