"""What is not the whole bag of a trial is refused, in one line that names it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from synthetic_trial import SyntheticTrial

from tel_ros.core.errors import BagError
from tel_ros.core.trial import Outcome
from tel_ros.recording import topics
from tel_ros.recording.bag_format import typestore
from tel_ros.recording.bag_writer import CHECKSUMS, TrialBagWriter
from tel_ros.recording.trial_bag import read_trial


def storage_file(bag: Path) -> Path:
    (file,) = bag.glob("*.mcap")
    return file


def edit_metadata(bag: Path, old: str, new: str) -> None:
    file = bag / "metadata.yaml"
    text = file.read_text(encoding="utf-8")
    assert old in text, text
    file.write_text(text.replace(old, new), encoding="utf-8")


def test_a_folder_that_is_not_there_is_refused(tmp_path: Path) -> None:
    with pytest.raises(
        BagError, match="trial_009: there is no such file or folder; expected a closed rosbag2 folder"
    ):
        read_trial(tmp_path / "trial_009")


def test_a_bag_without_its_metadata_was_never_closed(trial_bag: Path) -> None:
    (trial_bag / "metadata.yaml").unlink()
    with pytest.raises(BagError, match="trial_003: has no metadata.yaml: it was never closed"):
        read_trial(trial_bag)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "just words",
        "rosbag2_bagfile_information: [",
        "something_else: {}",
        "rosbag2_bagfile_information:",
        "rosbag2_bagfile_information: words",
        "rosbag2_bagfile_information: {custom_data: words}",
        "rosbag2_bagfile_information: {custom_data: {a: b}}",
        "rosbag2_bagfile_information: {version: 9, storage_identifier: mcap}",
        "\x00",
    ],
)
def test_garbled_metadata_are_refused_with_the_bag_named(trial_bag: Path, text: str) -> None:
    (trial_bag / "metadata.yaml").write_text(text, encoding="utf-8")
    with pytest.raises(BagError, match=r"(?s)trial_003.*expected") as refusal:
        read_trial(trial_bag)
    assert "\n" not in str(refusal.value), "a complaint is one line"


def test_metadata_that_are_no_text_are_refused(trial_bag: Path) -> None:
    (trial_bag / "metadata.yaml").write_bytes(b"\xff\xfe\x80")
    with pytest.raises(BagError, match=r"trial_003.*not readable.*expected the metadata of a rosbag2 folder"):
        read_trial(trial_bag)


@pytest.mark.parametrize("share", [0.0, 0.001, 0.3, 0.6, 0.9, 0.97, 0.999])
def test_a_truncated_bag_is_refused(trial_bag: Path, share: float) -> None:
    file = storage_file(trial_bag)
    data = file.read_bytes()
    file.write_bytes(data[: int(share * len(data))])
    with pytest.raises(BagError, match=r"trial_003: .*expected"):
        read_trial(trial_bag)


def damaged(file: Path, n: int, seed: int) -> Iterator[int]:
    """Turn one byte of a file round, n times another one."""
    whole = file.read_bytes()
    for place in np.random.default_rng(seed).choice(len(whole), n, replace=False).tolist():
        file.write_bytes(whole[:place] + bytes([whole[place] ^ 0xFF]) + whole[place + 1 :])
        yield place


def test_data_that_have_changed_since_they_were_recorded_are_refused(trial_bag: Path) -> None:
    said = r"trial_003: cannot be trusted: trial_003\.mcap has changed since it was recorded; expected the "
    for _ in damaged(storage_file(trial_bag), 40, seed=0):
        with pytest.raises(BagError, match=said):
            read_trial(trial_bag)


@pytest.mark.parametrize("seed", range(3))
def test_a_damaged_bag_without_checksums_raises_nothing_but_the_error_of_a_bag(
    trial_bag: Path, seed: int
) -> None:
    """What the reader makes of bytes that a failing disk has turned round is not for callers to know."""
    (trial_bag / CHECKSUMS).unlink()
    for _ in damaged(storage_file(trial_bag), 6, seed):
        try:
            read_trial(trial_bag)
        except BagError as error:
            assert "\n" not in str(error), "a complaint is one line"


def test_a_bag_of_a_recorder_that_writes_no_checksums_is_read(trial_bag: Path) -> None:
    (trial_bag / CHECKSUMS).unlink()
    assert read_trial(trial_bag).report.index == 3


@pytest.mark.parametrize("text", ["words", "0123  elsewhere.mcap", "\x00"])
def test_garbled_checksums_are_refused(trial_bag: Path, text: str) -> None:
    (trial_bag / CHECKSUMS).write_text(text, encoding="utf-8")
    with pytest.raises(BagError, match=r"trial_003: cannot be read .*; expected a closed rosbag2 folder"):
        read_trial(trial_bag)


def test_a_bag_without_its_storage_file_is_refused(trial_bag: Path) -> None:
    storage_file(trial_bag).unlink()
    with pytest.raises(BagError, match=r"trial_003: cannot be read .*expected a closed rosbag2 folder"):
        read_trial(trial_bag)


def test_a_bag_that_holds_less_than_it_announces_is_refused(trial_bag: Path) -> None:
    edit_metadata(trial_bag, "message_count: 125", "message_count: 126")
    with pytest.raises(
        BagError, match=r"yields 125 messages of /ep_controller/state; expected the 126 that it"
    ):
        read_trial(trial_bag)


def test_fewer_control_states_than_ticks_are_refused(tmp_path: Path, trial: SyntheticTrial) -> None:
    lost = iter([False] * 50 + [True] + [False] * 1000)
    bag = tmp_path / "bag"
    with TrialBagWriter(bag, {}) as writer:
        for topic, time_ns, data in trial.messages():
            if not (topic == topics.CONTROL_STATES and next(lost)):
                writer.write(topic, time_ns, data)
    with pytest.raises(
        BagError, match="bag: holds 119 control states; expected at least the trial's 120 ticks"
    ):
        read_trial(bag)


def test_a_bag_without_a_result_is_refused(tmp_path: Path, trial: SyntheticTrial) -> None:
    bag = trial.write(tmp_path / "bag", without=topics.TRIAL_RESULT)
    with pytest.raises(BagError, match="bag: holds 0 trial results; expected exactly one"):
        read_trial(bag)


def test_a_bag_without_a_goal_is_refused(tmp_path: Path, trial: SyntheticTrial) -> None:
    bag = trial.write(tmp_path / "bag", without=topics.TRIAL_GOAL)
    with pytest.raises(BagError, match="bag: holds 0 trial goals; expected exactly one"):
        read_trial(bag)


@pytest.mark.parametrize(
    ("topic", "what"),
    [(topics.TRIAL_GOAL, "goals"), (topics.TRIAL_RESULT, "results")],
    ids=["goal", "result"],
)
def test_a_bag_with_two_of_what_there_is_one_of_is_refused(
    tmp_path: Path, trial: SyntheticTrial, topic: str, what: str
) -> None:
    bag = tmp_path / "bag"
    with TrialBagWriter(bag, {}) as writer:
        for message in trial.messages():
            for _ in range(2 if message[0] == topic else 1):
                writer.write(*message)
    with pytest.raises(BagError, match=f"bag: holds 2 trial {what}; expected exactly one"):
        read_trial(bag)


def test_a_bag_of_another_trial_only_is_refused(tmp_path: Path, trial: SyntheticTrial) -> None:
    bag = trial.write(tmp_path / "bag", without=topics.CONTROL_STATES)
    with pytest.raises(
        BagError, match="bag: holds 0 control states; expected at least the trial's 120 ticks"
    ):
        read_trial(bag)


def test_a_trial_that_was_aborted_before_its_first_tick_has_a_whole_bag_without_any(tmp_path: Path) -> None:
    aborted = read_trial(SyntheticTrial(n=0, outcome=int(Outcome.ABORTED)).write(tmp_path / "bag"))
    assert aborted.report.outcome == Outcome.ABORTED
    assert aborted.position_rad.shape == aborted.saturated.shape == (0, 2)
    assert aborted.desired.shape == (0, 6)
    assert aborted.time_s.shape == (0,)
    completed = SyntheticTrial(n=0, outcome=int(Outcome.COMPLETED)).write(tmp_path / "completed")
    with pytest.raises(BagError, match="holds 0 control states"):
        read_trial(completed)


def test_a_bag_of_something_else_is_refused(tmp_path: Path, trial: SyntheticTrial) -> None:
    bag = tmp_path / "other"
    with Writer(bag, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection(
            f"/{topics.JOINT_STATES}", "sensor_msgs/msg/JointState", typestore=typestore()
        )
        writer.write(connection, 0, next(trial.messages())[2])
    with pytest.raises(BagError, match="other: has no topic /ep_controller/state; expected a bag of a trial"):
        read_trial(bag)


def test_a_result_with_an_outcome_that_there_is_not_is_refused(tmp_path: Path) -> None:
    bag = SyntheticTrial(outcome=9).write(tmp_path / "bag")
    with pytest.raises(BagError, match=r"bag: .*9.*expected"):
        read_trial(bag)


@pytest.mark.parametrize("joints", [("shoulder",), ("shoulder", "elbow", "wrist")], ids=len)
def test_control_states_with_values_for_other_joints_are_refused(
    tmp_path: Path, joints: tuple[str, ...]
) -> None:
    bag = SyntheticTrial(joints=joints).write(tmp_path / "bag")
    said = (
        f"bag: holds 2 values in desired_position_rad; expected one value for each of the joints {joints[0]}"
    )
    with pytest.raises(BagError, match=said):
        read_trial(bag)
