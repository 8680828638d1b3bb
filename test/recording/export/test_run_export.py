"""One file holds what the bags of a run hold, byte by byte, and what is added to it is true."""

from __future__ import annotations

import shutil
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from rosbags.highlevel import AnyReader

from tel_ros.core.config import RecordingConfig
from tel_ros.core.errors import BagError
from tel_ros.core.types import NS_PER_S
from tel_ros.recording import topics
from tel_ros.recording.bag_inspection import inspect_bag
from tel_ros.recording.bag_writer import BagWriter
from tel_ros.recording.export import added_messages
from tel_ros.recording.export.added_messages import THINNED_NS, thinned
from tel_ros.recording.export.run_export import GAP_NS, Export, export
from tel_ros.recording.trial_bag import read_metadata, read_trial

SAMPLE = Path(__file__).parents[3] / "bags" / "sample_run"
LINK_M = 0.33  # both links of the sample run's arm

Row = tuple[str, int, bytes]


def rows(bag: Path) -> list[Row]:
    with AnyReader([bag]) as reader:
        return [(c.topic, time_ns, bytes(raw)) for c, time_ns, raw in reader.messages()]


def messages(bag: Path, topic: str) -> list[tuple[int, Any]]:
    with AnyReader([bag]) as reader:
        connections = [c for c in reader.connections if c.topic == topic]
        return [(t, reader.deserialize(raw, c.msgtype)) for c, t, raw in reader.messages(connections)]


def stamp_ns(header: Any) -> int:
    return int(header.stamp.sec) * NS_PER_S + int(header.stamp.nanosec)


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Export:
    """The sample run in one file. Tests only look at it."""
    return export(SAMPLE, tmp_path_factory.mktemp("export") / "sample")


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """A copy of the sample run, to be spoiled."""
    return shutil.copytree(SAMPLE, tmp_path / "run")


def spoil(bag: Path) -> None:
    sums = bag / "SHA256SUMS"
    sums.write_text("0" * 64 + sums.read_text(encoding="utf-8")[64:], encoding="utf-8")


def test_every_recorded_message_is_there_unchanged_and_at_its_time(exported: Export) -> None:
    recorded = [row for k in (1, 2) for row in rows(SAMPLE / f"trial_00{k}")]
    found = rows(exported.folder)
    assert Counter(row for row in found if row[0] not in added_messages.ADDED) == Counter(recorded)
    assert [trial.shift_s for trial in exported.trials] == [0.0, 0.0]
    assert Counter(topic for topic, *_ in found) == exported.counts
    assert set(added_messages.ADDED) <= set(exported.counts)


def test_recorded_types_and_offers_are_as_they_were(exported: Export) -> None:
    with AnyReader([SAMPLE / "trial_001"]) as before, AnyReader([exported.folder]) as after:
        told = {c.topic: (c.msgtype, c.digest, c.ext) for c in after.connections}
        assert all(told[c.topic] == (c.msgtype, c.digest, c.ext) for c in before.connections)


def test_the_error_is_the_one_that_the_trials_result_tells(exported: Export) -> None:
    results = [result for _, result in messages(exported.folder, f"/{topics.TRIAL_RESULT}")]
    errors = messages(exported.folder, added_messages.ERROR)
    for trial, result in zip(exported.trials, results, strict=True):
        begin_ns, end_ns = round(trial.begin_s * NS_PER_S), round(trial.end_s * NS_PER_S)
        error_rad = np.array([message.data for time_ns, message in errors if begin_ns <= time_ns < end_ns])
        rms_rad = np.sqrt(np.mean(error_rad**2, axis=0))
        np.testing.assert_allclose(rms_rad, result.rms_error_per_joint_rad, rtol=1e-9)


def test_links_put_the_hand_where_the_joint_states_say(exported: Export) -> None:
    heard = messages(exported.folder, f"/{topics.JOINT_STATES}")
    states = {time_ns: state.position for time_ns, state in heard}
    ((_, still),) = messages(exported.folder, added_messages.TF_STATIC)
    transforms = messages(exported.folder, added_messages.TF)
    assert {t.header.frame_id for t in still.transforms} | {"base", "upper_arm"} == {
        "base",
        "upper_arm",
        "forearm",
    }
    for time_ns, moving in transforms[::20]:
        placed = {t.child_frame_id: t for t in (*still.transforms, *moving.transforms)}
        assert {stamp_ns(t.header) for t in moving.transforms} == {time_ns}
        hand_m, link = np.zeros(3), "hand"
        while link != exported.arm.root:
            move, turn = placed[link].transform.translation, placed[link].transform.rotation
            angle = 2.0 * np.arctan2(turn.z, turn.w)
            assert (turn.x, turn.y) == (0.0, 0.0)  # both axes are vertical
            c, s = np.cos(angle), np.sin(angle)
            hand_m = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ hand_m + [move.x, move.y, move.z]
            link = placed[link].header.frame_id
        q, both = states[time_ns][0], sum(states[time_ns])
        expected = LINK_M * np.array([np.cos(q) + np.cos(both), np.sin(q) + np.sin(both), 0.0])
        np.testing.assert_allclose(hand_m, expected, atol=1e-12)  # rounding only


def test_poses_come_about_fifty_times_a_second(exported: Export) -> None:
    for trial in exported.trials:
        times_ns = [time_ns for time_ns, _ in messages(exported.folder, added_messages.TF)]
        inside = [t for t in times_ns if trial.begin_s < t / NS_PER_S < trial.end_s]
        assert len(inside) == pytest.approx(50.0 * (trial.end_s - trial.begin_s), rel=0.02)


def test_the_paths_of_a_trial_are_there_from_its_beginning(exported: Export) -> None:
    for topic, name in (
        (added_messages.DESIRED_PATH, "desired"),
        (added_messages.ACTUAL_PATH, "position_rad"),
        (added_messages.EQUILIBRIUM_PATH, "equilibrium_rad"),
    ):
        for trial, (time_ns, path) in zip(exported.trials, messages(exported.folder, topic), strict=True):
            recorded = read_trial(trial.bag)
            q = getattr(recorded, name)[recorded.run][-1, :2]
            last = path.poses[-1].pose.position
            expected = LINK_M * np.array([np.cos(q[0]) + np.cos(q.sum()), np.sin(q[0]) + np.sin(q.sum())])
            np.testing.assert_allclose([last.x, last.y], expected, atol=1e-12)
            assert time_ns == round(trial.begin_s * NS_PER_S)
            assert {pose.header.frame_id for pose in path.poses} == {path.header.frame_id} == {"base"}


def test_limits_of_effort_are_drawn_from_end_to_end(exported: Export) -> None:
    limits = messages(exported.folder, added_messages.EFFORT_LIMIT)
    ends_s = [end for trial in exported.trials for end in (trial.begin_s, trial.end_s)]
    assert [time_ns / NS_PER_S for time_ns, _ in limits] == ends_s
    assert all(list(message.data) == [20.0, 20.0, -20.0, -20.0] for _, message in limits)


def test_the_arm_is_described_as_it_was(exported: Export) -> None:
    ((_, message),) = messages(exported.folder, added_messages.ROBOT_DESCRIPTION)
    assert message.data == read_metadata(SAMPLE / "trial_001")["file.arm.urdf"]


def test_trials_of_a_clock_that_began_anew_come_one_after_another(run: Path, tmp_path: Path) -> None:
    shutil.rmtree(run / "trial_001")
    shutil.copytree(run / "trial_002", run / "trial_001")  # the shorter one
    exported = export(run, tmp_path / "out")
    first, second = exported.trials
    assert second.begin_s == pytest.approx(first.end_s + GAP_NS / NS_PER_S)
    moved = [row for row in rows(exported.folder) if row[1] >= second.begin_s * NS_PER_S]
    shift_ns = round(second.shift_s * NS_PER_S)
    recorded = [(topic, time_ns + shift_ns, raw) for topic, time_ns, raw in rows(run / "trial_001")]
    assert Counter(row for row in moved if row[0] not in added_messages.ADDED) == Counter(recorded)
    for time_ns, message in messages(exported.folder, added_messages.TF):
        assert stamp_ns(message.transforms[0].header) == time_ns
    for topic in (
        *added_messages.STREAMED,
        added_messages.DESIRED_PATH,
        added_messages.ACTUAL_PATH,
        added_messages.EQUILIBRIUM_PATH,
    ):
        times_ns = [time_ns for time_ns, _ in messages(exported.folder, topic)]
        half = len(times_ns) // 2
        assert times_ns[half:] == [time_ns + shift_ns for time_ns in times_ns[:half]]


def test_a_bag_in_sqlite3_gives_the_same_file(tmp_path: Path) -> None:
    bag = SAMPLE / "trial_002"
    recording = RecordingConfig(storage="sqlite3")
    with (
        AnyReader([bag]) as reader,
        BagWriter(tmp_path / "trial_002", read_metadata(bag), recording) as writer,
    ):
        for connection in reader.connections:
            offered = connection.ext.offered_qos_profiles
            writer.add_topic(connection.topic, connection.msgtype, offered)
        for connection, time_ns, raw in reader.messages():
            writer.write(connection.topic, time_ns, bytes(raw))
    exported = export(tmp_path / "trial_002", tmp_path / "out")
    assert exported.file.suffix == ".mcap"
    assert Counter(rows(exported.folder)) == Counter(rows(export(bag, tmp_path / "of_mcap").folder))


def test_the_export_of_a_run_is_a_whole_bag_that_nothing_is_learned_from(exported: Export) -> None:
    assert inspect_bag(exported.folder).wholeness.is_good
    with pytest.raises(BagError, match="holds 2 trial results"):
        read_trial(exported.folder)


def test_a_trial_that_is_not_whole_is_left_out_and_named(run: Path, tmp_path: Path) -> None:
    spoil(run / "trial_001")
    exported = export(run, tmp_path / "out")
    assert [trial.index for trial in exported.trials] == [2]
    ((bag, problem),) = exported.left_out.items()
    assert bag == run / "trial_001"
    assert "has changed since it was recorded" in problem


def test_a_trial_of_another_arm_is_left_out(run: Path, tmp_path: Path) -> None:
    shutil.move(run / "trial_002", tmp_path / "before")
    metadata, swapped = read_metadata(tmp_path / "before"), ["elbow", "shoulder"]
    metadata["config"] = metadata["config"].replace("[shoulder, elbow]", "[elbow, shoulder]")
    with (
        AnyReader([tmp_path / "before"]) as reader,
        BagWriter(run / "trial_002", metadata) as writer,
    ):
        for connection in reader.connections:
            writer.add_topic(connection.topic, connection.msgtype, ())
        for connection, time_ns, raw in reader.messages():
            if connection.topic.removeprefix("/") in topics.RECORDED_ONCE:
                message = reader.deserialize(raw, connection.msgtype)
                message.joint_names = swapped  # type: ignore[attr-defined]
                raw = reader.typestore.serialize_cdr(message, connection.msgtype)
            writer.write(connection.topic, time_ns, bytes(raw))
    exported = export(run, tmp_path / "out")
    assert exported.left_out == {run / "trial_002": "is of the joints elbow, shoulder, not shoulder, elbow"}


def without_urdf(run: Path) -> None:
    for bag in run.glob("trial_*"):
        file = bag / "metadata.yaml"
        metadata = yaml.safe_load(file.read_text(encoding="utf-8"))
        del metadata["rosbag2_bagfile_information"]["custom_data"]["file.arm.urdf"]
        file.write_text(yaml.safe_dump(metadata), encoding="utf-8")
    (run / "planar_arm.urdf").unlink()


def without_whole_trials(run: Path) -> None:
    for bag in run.glob("trial_*"):
        spoil(bag)


def without_trials(run: Path) -> None:
    for bag in run.glob("trial_*"):
        shutil.rmtree(bag)


@pytest.mark.parametrize(
    ("harm", "said"),
    [
        (without_urdf, "does not hold arm.urdf"),
        (without_whole_trials, r"has no trial that is whole \(trial_001 is broken .*; trial_002 is broken"),
        (without_trials, "has no trial"),
    ],
)
def test_a_run_that_gives_no_file_leaves_nothing_behind(
    run: Path, tmp_path: Path, harm: Callable[[Path], None], said: str
) -> None:
    harm(run)
    with pytest.raises(BagError, match=said):
        export(run, tmp_path / "somewhere" / "out")
    assert not (tmp_path / "somewhere").exists()


def test_a_disk_that_refuses_leaves_no_half_of_a_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(writer: BagWriter, topic: str, time_ns: int, raw: bytes) -> None:
        if time_ns > NS_PER_S:
            raise BagError(writer.bag, "cannot be written", "room on the disk")

    monkeypatch.setattr(BagWriter, "write", refuse)
    with pytest.raises(BagError, match="cannot be written"):
        export(SAMPLE, tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


def test_an_unfinished_bag_of_that_name_is_left_alone(tmp_path: Path) -> None:
    unfinished = tmp_path / ".unfinished" / "out"
    unfinished.mkdir(parents=True)
    with pytest.raises(BagError, match="an unfinished bag of that name is there"):
        export(SAMPLE, tmp_path / "out")
    assert unfinished.is_dir()


@pytest.mark.parametrize("n", [0, 1, 2, 500])
def test_thinning_keeps_both_ends_and_little_between(n: int) -> None:
    times_ns = 7 + np.arange(n) * 2_000_000
    kept = thinned(times_ns)
    assert list(kept[[0, -1]]) == [0, n - 1] if n else kept.size == 0
    assert np.all(np.diff(times_ns[kept])[:-1] == THINNED_NS)
