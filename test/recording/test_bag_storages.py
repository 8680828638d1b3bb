"""Both storages: the same trial comes back, messages reach the disk in time, and a full disk is said."""

from __future__ import annotations

import resource
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
import yaml
from rosbags.highlevel import AnyReader
from rosbags.interfaces import QosDurability, QosReliability
from synthetic_trial import METADATA, PERIOD_NS, SyntheticTrial

from tel_ros.core.config import RecordingConfig
from tel_ros.core.errors import BagError
from tel_ros.core.types import NS_PER_S
from tel_ros.recording import topics
from tel_ros.recording.bag_writer import CHECKSUMS, CUSTOM_DATA_FILE, UNFINISHED, TrialBagWriter
from tel_ros.recording.recover import recover
from tel_ros.recording.trial_bag import read_trial


@pytest.fixture(params=["mcap", "sqlite3"])
def recording(request: pytest.FixtureRequest) -> RecordingConfig:
    return RecordingConfig(storage=request.param, chunk_s=0.02)


def data_file(bag: Path) -> Path:
    (file,) = [file for file in bag.iterdir() if file.suffix in (".mcap", ".db3")]
    return file


@contextmanager
def no_file_above(size: int) -> Iterator[None]:
    """Let no file of this process grow any further, as on a disk that is full."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def test_a_trial_is_the_same_in_either_storage(
    tmp_path: Path, trial: SyntheticTrial, recording: RecordingConfig
) -> None:
    bag = trial.write(tmp_path / "trial_003", recording=recording)
    found, plain = read_trial(bag), read_trial(trial.write(tmp_path / "plain"))
    for name in ("time_ns", "phase", "desired", "equilibrium_rad", "position_rad", "effort_nm", "saturated"):
        np.testing.assert_array_equal(getattr(found, name), getattr(plain, name))
    assert found.metadata == plain.metadata == METADATA
    assert {file.name for file in bag.iterdir()} == {"metadata.yaml", CHECKSUMS, data_file(bag).name}
    information = yaml.safe_load((bag / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert information["storage_identifier"] == recording.storage
    assert (information["version"], information["relative_file_paths"]) == (9, [data_file(bag).name])


def test_a_bag_tells_players_to_be_reliable_and_to_keep_what_comes_once_for_late_ones(
    tmp_path: Path, trial: SyntheticTrial, recording: RecordingConfig
) -> None:
    with AnyReader([trial.write(tmp_path / "trial_003", recording=recording)]) as reader:
        offered = {c.topic: c.ext.offered_qos_profiles for c in reader.connections}
    assert {qos.reliability for (qos,) in offered.values()} == {QosReliability.RELIABLE}
    late = {topic for topic, (qos,) in offered.items() if qos.durability == QosDurability.TRANSIENT_LOCAL}
    assert late == {f"/{topics.TRIAL_GOAL}", f"/{topics.TRIAL_RESULT}"}


def test_data_that_have_changed_are_refused_in_either_storage(
    tmp_path: Path, trial: SyntheticTrial, recording: RecordingConfig
) -> None:
    file = data_file(trial.write(tmp_path / "trial_003", recording=recording))
    data = bytearray(file.read_bytes())
    data[len(data) // 2] ^= 0xFF
    file.write_bytes(data)
    with pytest.raises(BagError, match=rf"cannot be trusted: {file.name} has changed"):
        read_trial(tmp_path / "trial_003")


@pytest.mark.parametrize("announced", ["message_count: 124", "message_count: 126"])
def test_announced_and_delivered_messages_are_compared_in_either_storage(
    tmp_path: Path, trial: SyntheticTrial, recording: RecordingConfig, announced: str
) -> None:
    bag = trial.write(tmp_path / "trial_003", recording=recording)
    file = bag / "metadata.yaml"
    file.write_text(file.read_text().replace("message_count: 125", announced))
    with pytest.raises(BagError, match=f"yields 125 messages of .*; expected the {announced[-3:]} that it"):
        read_trial(bag)


def test_messages_are_in_the_file_no_later_than_a_chunk_after_they_came(
    tmp_path: Path, trial: SyntheticTrial, recording: RecordingConfig
) -> None:
    """At whatever moment the process dies: looked at after every message."""
    writer = TrialBagWriter(tmp_path / "trial_003", METADATA, recording)
    unfinished = tmp_path / UNFINISHED / "trial_003"
    chunk_ns, content, since_ns, longest_ns = round(recording.chunk_s * NS_PER_S), b"", None, 0
    for topic, time_ns, data in trial.messages():
        if topic not in (topics.JOINT_STATES, topics.EFFORT_COMMANDS):
            continue
        since_ns = time_ns if since_ns is None else since_ns
        writer.write(topic, time_ns, data)
        longest_ns = max(longest_ns, time_ns - since_ns)
        if (now := data_file(unfinished).read_bytes()) != content:
            content, since_ns = now, None
    assert 0 < longest_ns <= chunk_ns + PERIOD_NS
    writer.abandon()


def test_a_clock_that_jumps_back_does_not_keep_messages_from_the_disk(
    tmp_path: Path, trial: SyntheticTrial, recording: RecordingConfig
) -> None:
    writer = TrialBagWriter(tmp_path / "trial_003", METADATA, recording)
    data = next(trial.messages())[2]
    for time_s in (100.0, 5.0):
        writer.write(topics.JOINT_STATES, round(time_s * NS_PER_S), data)
    shutil.copytree(tmp_path / UNFINISHED, tmp_path / "crashed" / UNFINISHED)
    writer.abandon()
    assert recover(tmp_path / "crashed" / UNFINISHED / "trial_003").counts[f"/{topics.JOINT_STATES}"] == 2


def test_the_configuration_is_on_the_disk_before_the_first_message(
    tmp_path: Path, recording: RecordingConfig
) -> None:
    writer = TrialBagWriter(tmp_path / "trial_003", METADATA, recording)
    file = tmp_path / UNFINISHED / "trial_003" / CUSTOM_DATA_FILE
    assert yaml.safe_load(file.read_text(encoding="utf-8")) == METADATA
    writer.abandon()


@pytest.mark.parametrize("size", [50_000, 70_000])
def test_a_full_disk_is_said_with_path_and_space_and_costs_no_chunk_before_it(
    tmp_path: Path, recording: RecordingConfig, size: int
) -> None:
    trial = SyntheticTrial(n=400)
    bag = tmp_path / "trial_003"
    writer = TrialBagWriter(bag, METADATA, recording)
    written = []
    said = r"trial_003: cannot be written \(.*; \d+ MB are free there\); expected room on the disk"
    with no_file_above(size), pytest.raises(BagError, match=said):
        for message in trial.messages():
            writer.write(*message)
            written.append(message)
    writer.abandon()
    assert not bag.exists()
    found = recover(tmp_path / UNFINISHED / "trial_003")
    per_chunk = 3 * (recording.chunk_s * NS_PER_S / PERIOD_NS + 1)
    assert len(written) - per_chunk <= sum(found.counts.values()) <= len(written) + 1


def test_a_disk_that_fills_up_at_the_end_leaves_no_bag_under_the_trials_name(
    tmp_path: Path, trial: SyntheticTrial
) -> None:
    for storage in ("mcap", "sqlite3"):
        bag = tmp_path / storage / "trial_003"
        writer = TrialBagWriter(bag, METADATA, RecordingConfig(storage=storage, chunk_s=100.0))
        for message in trial.messages():
            writer.write(*message)
        with (
            no_file_above(20_000),
            pytest.raises(BagError, match="could not be closed .*; expected room on the"),
        ):
            writer.close()
        writer.abandon()
        assert not bag.exists()
        assert (bag.parent / UNFINISHED / "trial_003").is_dir()
