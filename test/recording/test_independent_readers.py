"""Bags are read alike by readers that share no code with what wrote them, and that have none of our files."""

from __future__ import annotations

import sqlite3
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from synthetic_trial import SyntheticTrial

from tel_ros.core.config import RecordingConfig
from tel_ros.recording import topics
from tel_ros.recording.trial_bag import read_trial

pytest.importorskip("mcap")
DecoderFactory = pytest.importorskip("mcap_ros2.decoder").DecoderFactory
read_bag = pytest.importorskip("rosbag_doctor.readers").read_bag

from mcap.reader import make_reader  # noqa: E402
from mcap.records import Schema  # noqa: E402

Decoded = tuple[str, int, bytes, Any]
"""Topic, time in ns, bytes, message."""


def by_mcap(bag: Path) -> Iterator[Decoded]:
    with (bag / f"{bag.name}.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        for _, channel, message, decoded in reader.iter_decoded_messages():
            yield channel.topic, message.log_time, message.data, decoded


def by_sqlite3(bag: Path) -> Iterator[Decoded]:
    """Read the database by itself, and the messages by the definitions in it."""
    with closing(sqlite3.connect(bag / f"{bag.name}.db3")) as database:
        assert database.execute("PRAGMA integrity_check").fetchone() == ("ok",)
        definitions = database.execute(
            "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
        )
        factory = DecoderFactory()
        decoders = {
            kind: factory.decoder_for("cdr", Schema(id=k, name=kind, encoding=encoding, data=text.encode()))
            for k, (kind, encoding, text) in enumerate(definitions, start=1)
        }
        messages = database.execute(
            "SELECT name, type, timestamp, data FROM messages JOIN topics ON topics.id = topic_id"
            " ORDER BY timestamp, messages.id"
        )
        for topic, kind, time_ns, data in messages:
            yield topic, time_ns, data, decoders[kind](data)


READERS: dict[str, Callable[[Path], Iterator[Decoded]]] = {"mcap": by_mcap, "sqlite3": by_sqlite3}


@pytest.fixture(params=READERS)
def stored(request: pytest.FixtureRequest, tmp_path: Path, trial: SyntheticTrial) -> tuple[str, Path]:
    """Return the name of a storage and a bag of several chunks in it."""
    recording = RecordingConfig(storage=request.param, chunk_s=0.05)
    return request.param, trial.write(tmp_path / "trial_003", recording=recording)


def test_another_reader_finds_the_same_messages(stored: tuple[str, Path], trial: SyntheticTrial) -> None:
    storage, bag = stored
    found = [message[:3] for message in READERS[storage](bag)]
    assert sorted(found) == sorted(trial.recorded())
    with AnyReader([bag]) as reader:
        ours = Counter({c.topic: c.msgcount for c in reader.connections})
    assert Counter(topic for topic, _, _ in found) == ours


def test_another_reader_finds_the_same_values(stored: tuple[str, Path]) -> None:
    storage, bag = stored
    messages = list(READERS[storage](bag))
    ours = read_trial(bag)
    control = [m for topic, *_, m in messages if topic == f"/{topics.CONTROL_STATES}"]
    states = [state for state in control if state.trial == ours.report.index]
    for name in ("position_rad", "velocity_rad_s", "equilibrium_rad", "effort_nm", "saturated"):
        np.testing.assert_array_equal([getattr(state, name) for state in states], getattr(ours, name))
    stamps = [state.header.stamp.sec * 10**9 + state.header.stamp.nanosec for state in states]
    np.testing.assert_array_equal(stamps, ours.time_ns)
    positions = [m.position for topic, *_, m in messages if topic == f"/{topics.JOINT_STATES}"]
    np.testing.assert_array_equal(positions[: len(states)], ours.position_rad)
    (goal,) = (m for topic, *_, m in messages if topic == f"/{topics.TRIAL_GOAL}")
    (result,) = (m for topic, *_, m in messages if topic == f"/{topics.TRIAL_RESULT}")
    assert (goal.trial, result.index, result.ticks) == (3, 3, len(ours.time_ns))
    assert result.duration_s == ours.report.duration_s


def test_a_checker_of_bags_finds_the_announced_messages_at_the_same_times(
    stored: tuple[str, Path], trial: SyntheticTrial
) -> None:
    storage, bag = stored
    checked = read_bag(bag)
    assert (checked.storage, checked.reader_warnings) == (storage, [])
    times = {topic: list(series.timestamps_ns) for topic, series in checked.topics.items()}
    expected: dict[str, list[int]] = {}
    for topic, time_ns, _ in trial.recorded():
        expected.setdefault(topic, []).append(time_ns)
    assert times == expected
    assert checked.metadata_topic_counts == {topic: len(stamps) for topic, stamps in times.items()}
