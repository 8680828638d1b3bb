"""Reading a trial back, and refusing what is not a whole one."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from synthetic_trial import JOINTS, METADATA, SyntheticTrial

from tel_ros.core.control.records import Outcome, Phase
from tel_ros.core.errors import BagError
from tel_ros.core.learning.signals import training_samples
from tel_ros.recording import topics
from tel_ros.recording.bag_writer import CHECKSUMS, TrialBagWriter
from tel_ros.recording.message_types import typestore
from tel_ros.recording.trial_bag import RecordedTrial, read_trial


def storage_file(bag: Path) -> Path:
    (file,) = bag.glob("*.mcap")
    return file


def edit_metadata(bag: Path, old: str, new: str) -> None:
    file = bag / "metadata.yaml"
    text = file.read_text(encoding="utf-8")
    assert old in text, text
    file.write_text(text.replace(old, new), encoding="utf-8")


def swing(end: Phase) -> RecordedTrial:
    """Return a smooth motion in formulas: two seconds of rest, two of RUN, and one in a last phase."""
    time_ns = np.arange(0, 5_000_000_000, 2_000_000)
    t, w = time_ns / 1e9, 2 * np.pi * 0.7
    q = np.column_stack([0.5 * np.sin(w * t), 0.3 * np.cos(w * t)])
    phase = np.select([t < 2.0, t <= 4.0], [Phase.SETTLE, Phase.RUN], end)
    return RecordedTrial(
        bag=Path("trial_001"),
        metadata={},
        joints=JOINTS,
        index=1,
        outcome=Outcome.ABORTED if end == Phase.STOP else Outcome.COMPLETED,
        message="",
        duration_s=2.0,
        time_ns=time_ns,
        phase=phase.astype(np.int64),
        desired=np.hstack([q, w * q, -(w**2) * q]),
        equilibrium_rad=q + 0.1 * np.cos(w * t)[:, None],
        position_rad=q,
        velocity_rad_s=q,
        effort_nm=q,
        saturated=np.zeros(q.shape, dtype=bool),
    )


def test_a_trial_comes_back_bit_by_bit(trial_bag: Path, trial: SyntheticTrial) -> None:
    found, n = read_trial(trial_bag), trial.n
    desired = [f"desired_{name}" for name in ("position_rad", "velocity_rad_s", "acceleration_rad_s2")]
    np.testing.assert_array_equal(found.desired, np.hstack([trial.values[name][:n] for name in desired]))
    for name in ("equilibrium_rad", "position_rad", "velocity_rad_s", "effort_nm"):
        np.testing.assert_array_equal(getattr(found, name), trial.values[name][:n])
    np.testing.assert_array_equal(found.time_ns, trial.time_ns[:n])
    np.testing.assert_array_equal(found.phase, trial.phase[:n])
    np.testing.assert_array_equal(found.saturated, trial.saturated[:n])
    assert (found.bag, found.joints, found.index, found.duration_s) == (trial_bag, JOINTS, 3, 9.0)
    assert (found.outcome, found.message, dict(found.metadata)) == (Outcome.COMPLETED, "", METADATA)


def test_an_aborted_trial_says_so(tmp_path: Path) -> None:
    bag = SyntheticTrial(outcome=1, message="elbow is off").write(tmp_path / "bag")
    found = read_trial(bag)
    assert (found.outcome, found.message) == (Outcome.ABORTED, "elbow is off")


def test_time_counts_from_the_first_tick_of_run(trial_bag: Path, trial: SyntheticTrial) -> None:
    found = read_trial(trial_bag)
    first = int(np.argmax(trial.phase == Phase.RUN))
    np.testing.assert_allclose(found.time_s, (np.arange(trial.n) - first) * 0.002, atol=1e-12)
    np.testing.assert_array_equal(found.run, trial.phase[: trial.n] == Phase.RUN)


def test_the_signals_leave_out_the_way_to_the_start(trial_bag: Path, trial: SyntheticTrial) -> None:
    signals = read_trial(trial_bag).signals()
    kept = trial.phase[: trial.n] != Phase.APPROACH
    np.testing.assert_array_equal(signals.time_ns, trial.time_ns[: trial.n][kept])
    np.testing.assert_array_equal(signals.position_rad, trial.values["position_rad"][: trial.n][kept])
    np.testing.assert_array_equal(signals.equilibrium_rad, trial.values["equilibrium_rad"][: trial.n][kept])
    np.testing.assert_array_equal(signals.run, trial.phase[: trial.n][kept] == Phase.RUN)


@pytest.mark.parametrize("end", [Phase.HOLD, Phase.STOP], ids=lambda phase: phase.name)
def test_the_last_ticks_of_run_are_learned_as_well_as_the_others(end: Phase) -> None:
    """A record that breaks off in mid-motion would leave the transient of its filter there."""
    trial = swing(end)
    samples = training_samples(trial.signals(), 15.0)
    t, w = trial.time_ns[trial.run] / 1e9, 2 * np.pi * 0.7
    expected = -0.5 * w**2 * np.sin(w * (t + 0.001))
    # Accelerations are up to 9.7 rad/s²; a twentieth of that is a hundred times what is usual in mid-record.
    np.testing.assert_allclose(samples.actual[-30:, 4], expected[-30:], atol=0.5)


def test_the_command_of_the_brake_does_not_reach_into_what_is_learned() -> None:
    trial = swing(Phase.STOP)
    braked = trial.equilibrium_rad - 0.5 * (trial.phase == Phase.STOP)[:, None]
    samples = training_samples(dataclasses.replace(trial, equilibrium_rad=braked).signals(), 15.0)
    expected = (trial.equilibrium_rad - trial.position_rad)[trial.run]
    # A hundredth of a radian is what the filter makes of û coming to a sudden rest.
    np.testing.assert_allclose(samples.offset_rad[-30:], expected[-30:], atol=0.01)


@pytest.mark.parametrize("jump_ns", [-10_000_000, -5_000_000_000, 1_700_000_000_000_000_000])
def test_a_stop_behind_a_jump_in_time_is_no_part_of_the_record(jump_ns: int) -> None:
    """The clock of an arm that was started anew would stretch the record to years."""
    trial = swing(Phase.STOP)
    stop = trial.phase == Phase.STOP
    jumped = dataclasses.replace(trial, time_ns=trial.time_ns + jump_ns * stop)
    np.testing.assert_array_equal(jumped.signals().time_ns, trial.time_ns[~stop])
    assert trial.signals().time_ns.tolist() == trial.time_ns.tolist()


def test_a_trial_that_never_left_the_approach_has_nothing_to_learn_from() -> None:
    trial = swing(Phase.STOP)
    phase = np.where(trial.phase == Phase.STOP, Phase.STOP, Phase.APPROACH)
    assert len(dataclasses.replace(trial, phase=phase).signals().time_ns) == 0


def test_a_folder_that_is_not_there_is_refused(tmp_path: Path) -> None:
    with pytest.raises(
        BagError, match="trial_009: there is no such folder; expected a closed rosbag2 folder"
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
    assert read_trial(trial_bag).index == 3


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


def test_a_bag_of_another_trial_only_is_refused(tmp_path: Path, trial: SyntheticTrial) -> None:
    bag = trial.write(tmp_path / "bag", without=topics.CONTROL_STATES)
    with pytest.raises(
        BagError, match="bag: holds 0 control states; expected at least the trial's 120 ticks"
    ):
        read_trial(bag)


def test_a_bag_of_something_else_is_refused(tmp_path: Path, trial: SyntheticTrial) -> None:
    bag = tmp_path / "other"
    with Writer(bag, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection(
            topics.JOINT_STATES, "sensor_msgs/msg/JointState", typestore=typestore()
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
