"""Reading a trial back, and refusing what is not a whole one."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore
from synthetic_trial import JOINTS, METADATA, SyntheticTrial

from tel_ros.core.config import Config
from tel_ros.core.errors import BagError, counted
from tel_ros.core.learning.signals import learning_record
from tel_ros.core.springs import Springs
from tel_ros.core.trial import Outcome, Phase
from tel_ros.recording import topics
from tel_ros.recording.bag_format import typestore
from tel_ros.recording.bag_writer import CHECKSUMS, TrialBagWriter
from tel_ros.recording.config_file import dump_config
from tel_ros.recording.shared_files import share_folder
from tel_ros.recording.trial_bag import read_trial


def storage_file(bag: Path) -> Path:
    (file,) = bag.glob("*.mcap")
    return file


def edit_metadata(bag: Path, old: str, new: str) -> None:
    file = bag / "metadata.yaml"
    text = file.read_text(encoding="utf-8")
    assert old in text, text
    file.write_text(text.replace(old, new), encoding="utf-8")


def std_of(trial: SyntheticTrial, n_points: int = 0) -> np.ndarray:
    """Return standard deviations for the points of a trial's goal, no two of them alike."""
    n_points = n_points or len(trial.time_ns)
    return 0.001 * (1.0 + np.arange(2 * n_points).reshape(-1, 2))


def test_a_trial_comes_back_bit_by_bit(trial_bag: Path, trial: SyntheticTrial) -> None:
    found, n = read_trial(trial_bag), trial.n
    desired = [f"desired_{name}" for name in ("position_rad", "velocity_rad_s", "acceleration_rad_s2")]
    np.testing.assert_array_equal(found.desired, np.hstack([trial.values[name][:n] for name in desired]))
    for name in ("equilibrium_rad", "position_rad", "velocity_rad_s", "effort_nm"):
        np.testing.assert_array_equal(getattr(found, name), trial.values[name][:n])
    np.testing.assert_array_equal(found.time_ns, trial.time_ns[:n])
    np.testing.assert_array_equal(found.phase, trial.phase[:n])
    np.testing.assert_array_equal(found.saturated, trial.saturated[:n])
    assert (found.bag, found.joints, found.report.index, found.report.duration_s) == (
        trial_bag,
        JOINTS,
        3,
        9.0,
    )
    assert (found.report.outcome, found.report.message, dict(found.metadata)) == (
        Outcome.COMPLETED,
        "",
        METADATA,
    )


def test_an_aborted_trial_says_so(tmp_path: Path) -> None:
    bag = SyntheticTrial(outcome=1, message="elbow is off").write(tmp_path / "bag")
    found = read_trial(bag)
    assert (found.report.outcome, found.report.message) == (Outcome.ABORTED, "elbow is off")


def test_time_counts_from_the_first_tick_of_run(trial_bag: Path, trial: SyntheticTrial) -> None:
    found = read_trial(trial_bag)
    first = int(np.argmax(trial.phase == Phase.RUN))
    np.testing.assert_allclose(found.time_s, (np.arange(trial.n) - first) * 0.002, atol=1e-12)
    np.testing.assert_array_equal(found.run, trial.phase[: trial.n] == Phase.RUN)


def test_the_signals_leave_out_the_way_to_the_start(trial_bag: Path, trial: SyntheticTrial) -> None:
    signals = learning_record(read_trial(trial_bag))
    kept = trial.phase[: trial.n] != Phase.APPROACH
    np.testing.assert_array_equal(signals.time_ns, trial.time_ns[: trial.n][kept])
    np.testing.assert_array_equal(signals.position_rad, trial.values["position_rad"][: trial.n][kept])
    np.testing.assert_array_equal(signals.equilibrium_rad, trial.values["equilibrium_rad"][: trial.n][kept])
    np.testing.assert_array_equal(signals.run, trial.phase[: trial.n][kept] == Phase.RUN)
    np.testing.assert_array_equal(signals.saturated, trial.saturated[: trial.n][kept])


def test_the_networks_std_comes_back_for_the_ticks_of_run(tmp_path: Path, trial: SyntheticTrial) -> None:
    trial.std_rad = std_of(trial)
    trial.std_rad[5] = np.inf, 0.5
    found = read_trial(trial.write(tmp_path / "bag"))
    n_run = np.count_nonzero(trial.phase[: trial.n] == Phase.RUN)
    assert n_run > 5
    np.testing.assert_array_equal(found.command_std_rad, trial.std_rad[:n_run])


def test_beyond_the_trajectory_its_last_std_holds(tmp_path: Path, trial: SyntheticTrial) -> None:
    trial.n_points = 4
    trial.std_rad = std_of(trial, 4)
    found = read_trial(trial.write(tmp_path / "bag")).command_std_rad
    np.testing.assert_array_equal(found[:4], trial.std_rad)
    assert len(found) > 4
    np.testing.assert_array_equal(found[4:], np.broadcast_to(trial.std_rad[3], found[4:].shape))


def test_without_a_std_nothing_is_known(trial_bag: Path, trial: SyntheticTrial) -> None:
    n_run = np.count_nonzero(trial.phase[: trial.n] == Phase.RUN)
    np.testing.assert_array_equal(read_trial(trial_bag).command_std_rad, np.full((n_run, 2), np.inf))


def test_a_bag_from_before_goals_had_a_std_is_read(
    tmp_path: Path, trial: SyntheticTrial, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A bag carries the definitions of its messages: its goal has no such field."""
    kind = topics.RECORDED_ONCE[topics.TRIAL_GOAL]
    older = types_without_std()
    monkeypatch.setattr("tel_ros.recording.bag_format.typestore", lambda: older)
    with TrialBagWriter(tmp_path / "bag", {}) as writer:
        for topic, time_ns, data in trial.messages():
            if topic == topics.TRIAL_GOAL:
                goal = vars(typestore().deserialize_cdr(data, kind))
                newer = ("std_rad", "stiffness_nm_per_rad", "damping_nms_per_rad", "__msgtype__")
                fields = {name: value for name, value in goal.items() if name not in newer}
                data = bytes(older.serialize_cdr(older.types[kind](**fields), kind))
            writer.write(topic, time_ns, data)
    found = read_trial(tmp_path / "bag")
    assert len(found.command_std_rad) > 0
    assert np.isposinf(found.command_std_rad).all()
    assert found.springs is None


def types_without_std() -> Typestore:
    """Return the types of bags as they were when a goal had neither ``std_rad`` nor springs."""
    store = get_typestore(Stores.ROS2_JAZZY)
    for file in (share_folder("tel_interfaces") / "msg").glob("*.msg"):
        newer = ("std_rad", "stiffness_nm_per_rad", "damping_nms_per_rad")
        lines = file.read_text(encoding="utf-8").splitlines()
        lines = [line for line in lines if not any(name in line for name in newer)]
        store.register(get_types_from_msg("\n".join(lines), f"tel_interfaces/msg/{file.stem}"))
    return store


def test_a_trial_with_the_configured_springs_has_no_others(trial_bag: Path) -> None:
    assert read_trial(trial_bag).springs is None


def test_the_springs_of_a_trial_come_back_and_what_they_did_is_learned(
    tmp_path: Path, trial: SyntheticTrial, config: Config
) -> None:
    configured = Springs.of(config.arm)
    used = configured.scaled(4.0)
    trial.springs = (tuple(used.stiffness_nm_per_rad), tuple(used.damping_nms_per_rad))
    found = read_trial(trial.write(tmp_path / "bag", METADATA | {"config": dump_config(config)}))
    assert found.springs is not None
    for springs, expected in ((found.springs.used, used), (found.springs.configured, configured)):
        np.testing.assert_array_equal(springs.stiffness_nm_per_rad, expected.stiffness_nm_per_rad)
        np.testing.assert_array_equal(springs.damping_nms_per_rad, expected.damping_nms_per_rad)
    kept = trial.phase[: trial.n] != Phase.APPROACH
    u, q, v = (
        trial.values[name][: trial.n][kept] for name in ("equilibrium_rad", "position_rad", "velocity_rad_s")
    )
    k, b = configured.stiffness_nm_per_rad, configured.damping_nms_per_rad
    exerted = 4.0 * k * (u - q) - 2.0 * b * v
    np.testing.assert_allclose(learning_record(found).equilibrium_rad, q + (exerted + b * v) / k, atol=1e-12)
    np.testing.assert_array_equal(found.equilibrium_rad, trial.values["equilibrium_rad"][: trial.n])


@pytest.mark.parametrize(
    "springs",
    [((60.0,), (3.0,)), ((60.0, 60.0), ()), ((), (3.0, 3.0)), ((60.0, -1.0), (3.0, 3.0))],
    ids=["too few", "no damping", "no stiffness", "negative"],
)
def test_springs_that_do_not_fit_are_refused(
    tmp_path: Path, trial: SyntheticTrial, config: Config, springs: tuple[tuple[float, ...], ...]
) -> None:
    trial.springs = springs  # type: ignore[assignment]
    bag = trial.write(tmp_path / "bag", METADATA | {"config": dump_config(config)})
    with pytest.raises(BagError, match="bag: does not tell how stiff its springs were"):
        read_trial(bag)


def test_springs_without_the_configured_ones_are_refused(tmp_path: Path, trial: SyntheticTrial) -> None:
    trial.springs = ((60.0, 60.0), (3.0, 3.0))
    with pytest.raises(BagError, match="and the configuration in the metadata"):
        read_trial(trial.write(tmp_path / "bag"))


@pytest.mark.parametrize("n", [1, 249, 251, 500])
def test_a_std_of_another_length_is_refused(tmp_path: Path, trial: SyntheticTrial, n: int) -> None:
    trial.std_rad = np.full(n, 0.01)
    said = (
        f"bag: its goal holds {counted(n, 'value')} in std_rad; expected nothing, or one value for each of "
        "the 125 points and 2 joints"
    )
    with pytest.raises(BagError, match=said):
        read_trial(trial.write(tmp_path / "bag"))


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
