"""Bags that are either whole or not there."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest
import yaml
from rosbags.highlevel import AnyReader
from synthetic_trial import METADATA, SyntheticTrial

from tel_ros.core.errors import BagError
from tel_ros.recording import topics
from tel_ros.recording.bag_writer import CHECKSUMS, UNFINISHED, TrialBagWriter
from tel_ros.recording.trial_bag import read_trial


def contents(bag: Path) -> list[tuple[str, int, bytes]]:
    """Return what a plain reader finds."""
    with AnyReader([bag]) as reader:
        return [(c.topic.removeprefix("/"), time_ns, bytes(raw)) for c, time_ns, raw in reader.messages()]


EFFORTS = {topics.EFFORT_COMMANDS: "std_msgs/msg/Float64MultiArray"}


def test_messages_come_back_byte_by_byte_with_their_times(trial_bag: Path, trial: SyntheticTrial) -> None:
    found = contents(trial_bag)
    assert sorted(found) == sorted(trial.messages())
    assert [time_ns for _, time_ns, _ in found] == sorted(time_ns for _, time_ns, _ in trial.messages())


def test_a_plain_reader_understands_our_own_messages_without_our_definitions(
    trial_bag: Path, trial: SyntheticTrial
) -> None:
    """The bag carries the definitions; nothing of this project is needed to read it."""
    with AnyReader([trial_bag]) as reader:
        types = {c.topic: c.msgtype for c in reader.connections}
        recorded = topics.RECORDED_LIVE | topics.RECORDED_ONCE | EFFORTS
        assert types == {f"/{topic}": kind for topic, kind in recorded.items()}
        connections = [c for c in reader.connections if c.topic == f"/{topics.CONTROL_STATES}"]
        states = [reader.deserialize(raw, c.msgtype) for c, _, raw in reader.messages(connections)]
    assert len(states) == 125
    assert states[17].equilibrium_rad.tolist() == trial.values["equilibrium_rad"][17].tolist()
    assert states[17].phase == trial.phase[17]


def test_what_is_stored_beside_the_messages_comes_back(trial_bag: Path) -> None:
    information = yaml.safe_load((trial_bag / "metadata.yaml").read_text(encoding="utf-8"))
    assert information["rosbag2_bagfile_information"]["custom_data"] == METADATA
    assert read_trial(trial_bag).metadata == METADATA


def test_the_writer_counts_what_it_has_written(tmp_path: Path, trial: SyntheticTrial) -> None:
    with TrialBagWriter(tmp_path / "bag", {}) as writer:
        for topic, time_ns, data in trial.messages():
            writer.write(topic, time_ns, data)
    live = [f"/{topic}" for topic in (*topics.RECORDED_LIVE, *EFFORTS)]
    assert writer.counts == dict.fromkeys(live, 125) | {f"/{topic}": 1 for topic in topics.RECORDED_ONCE}


def test_a_closed_bag_leaves_nothing_else_behind(trial_bag: Path) -> None:
    assert list(trial_bag.parent.iterdir()) == [trial_bag]


def test_the_checksums_of_a_bag_are_those_of_the_common_tool(trial_bag: Path) -> None:
    check = ["sha256sum", "--check", "--strict", CHECKSUMS]
    done = subprocess.run(check, cwd=trial_bag, capture_output=True, text=True, check=True)
    assert done.stdout == "trial_003.mcap: OK\n"


def test_a_bag_has_no_name_before_it_is_closed(tmp_path: Path, trial: SyntheticTrial) -> None:
    bag = tmp_path / "trial_001"
    writer = TrialBagWriter(bag, {})
    for topic, time_ns, data in trial.messages():
        writer.write(topic, time_ns, data)
    assert not bag.exists()
    with pytest.raises(
        BagError, match="trial_001: there is no such file or folder; expected a closed rosbag2 folder"
    ):
        read_trial(bag)
    with pytest.raises(BagError, match="never closed"):
        read_trial(tmp_path / UNFINISHED / "trial_001")
    writer.close()
    assert read_trial(bag).report.index == 3


def test_a_bag_that_an_error_interrupts_stays_among_the_unfinished(
    tmp_path: Path, trial: SyntheticTrial
) -> None:
    bag = tmp_path / "trial_001"
    with pytest.raises(RuntimeError, match="stop"), TrialBagWriter(bag, {}) as writer:
        writer.write(*next(trial.messages()))
        raise RuntimeError("stop")
    assert not bag.exists()
    assert (tmp_path / UNFINISHED / "trial_001").is_dir()
    with pytest.raises(BagError, match="has no metadata.yaml: it was never closed"):
        read_trial(tmp_path / UNFINISHED / "trial_001")


def test_other_unfinished_bags_are_left_alone_when_one_is_closed(
    tmp_path: Path, trial: SyntheticTrial
) -> None:
    TrialBagWriter(tmp_path / "trial_001", {}).abandon()
    trial.write(tmp_path / "trial_002")
    assert [path.name for path in (tmp_path / UNFINISHED).iterdir()] == ["trial_001"]


def test_a_bag_that_exists_is_not_overwritten(trial_bag: Path) -> None:
    before = contents(trial_bag)
    with pytest.raises(BagError, match="trial_003: exists already; expected a name that is free"):
        TrialBagWriter(trial_bag, {})
    assert contents(trial_bag) == before


def test_an_unfinished_bag_of_that_name_is_not_overwritten(tmp_path: Path) -> None:
    TrialBagWriter(tmp_path / "trial_001", {}).abandon()
    with pytest.raises(BagError, match=rf"{UNFINISHED}/trial_001: an unfinished bag of that name is there"):
        TrialBagWriter(tmp_path / "trial_001", {})


def test_a_place_that_cannot_be_written_is_refused_by_name(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(BagError, match="file/trial_001: cannot be written .*; expected a folder that can be"):
        TrialBagWriter(tmp_path / "file" / "trial_001", {})


def test_a_bag_that_cannot_get_its_name_is_not_taken_for_closed(
    tmp_path: Path, trial: SyntheticTrial
) -> None:
    bag = tmp_path / "trial_001"
    writer = TrialBagWriter(bag, {})
    for topic, time_ns, data in trial.messages():
        writer.write(topic, time_ns, data)
    bag.mkdir()
    (bag / "in_the_way").touch()
    with pytest.raises(BagError, match="trial_001: could not be closed .*; expected room on the disk"):
        writer.close()
    assert read_trial(tmp_path / UNFINISHED / "trial_001").report.index == 3
    assert [path.name for path in bag.iterdir()] == ["in_the_way"]
