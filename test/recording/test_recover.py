"""What a crash leaves of a recording: found up to the last whole chunk, and never trained on."""

from __future__ import annotations

import os
import shutil
import signal
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
import yaml
from rosbags.highlevel import AnyReader
from synthetic_trial import METADATA, PERIOD_NS, SyntheticTrial

from tel_ros.core.config import RecordingConfig
from tel_ros.core.errors import BagError
from tel_ros.core.trial import Outcome
from tel_ros.core.types import NS_PER_S
from tel_ros.recording import topics
from tel_ros.recording.bag_writer import CUSTOM_DATA_FILE, RECOVERED, UNFINISHED, TrialBagWriter
from tel_ros.recording.recover import recover
from tel_ros.recording.trial_bag import check_bag, read_trial

CHUNK_S = 0.02
STORAGES = ("mcap", "sqlite3")
Message = tuple[str, int, bytes]


def recorded_order(trial: SyntheticTrial) -> list[Message]:
    """Return the messages as a recorder writes them: the goal first, topics not in step with each other."""
    messages = list(trial.messages())
    goals = [m for m in messages if m[0] == topics.TRIAL_GOAL]
    states = [m for m in messages if m[0] == topics.JOINT_STATES]
    others = [m for m in messages if m[0] not in (topics.TRIAL_GOAL, topics.JOINT_STATES)]
    ordered = goals + states[:3]  # the states run ahead of what answers them
    for k, state in enumerate(states[3:]):
        ordered += [state, *others[2 * k : 2 * k + 2]]
    return ordered + others[2 * len(states[3:]) :]


def interrupted(folder: Path, storage: str, messages: list[Message]) -> Path:
    """Return a recording as SIGKILL leaves it: what has reached the file, and nothing of the buffers."""
    recording = RecordingConfig(storage=storage, chunk_s=CHUNK_S)  # type: ignore[arg-type]
    writer = TrialBagWriter(folder / "live" / "trial_003", METADATA, recording)
    for message in messages:
        writer.write(*message)
    unfinished = folder / "run" / UNFINISHED / "trial_003"
    shutil.copytree(folder / "live" / UNFINISHED / "trial_003", unfinished)
    writer.abandon()
    return unfinished


def contents(bag: Path) -> list[Message]:
    with AnyReader([bag]) as reader:
        return [(c.topic.removeprefix("/"), time_ns, bytes(raw)) for c, time_ns, raw in reader.messages()]


@pytest.mark.parametrize("storage", STORAGES)
@pytest.mark.parametrize("n", [60, 157, 301])
def test_all_but_the_last_chunk_is_recovered_byte_by_byte(
    tmp_path: Path, trial: SyntheticTrial, storage: str, n: int
) -> None:
    written = recorded_order(trial)[:n]
    found = recover(interrupted(tmp_path, storage, written))
    saved = contents(found.bag)
    first, last = saved[0][1], saved[-1][1]
    assert sorted(saved) == sorted(written[: len(saved)]), "a gap, or something that was never written"
    assert written[-1][1] - last <= CHUNK_S * NS_PER_S
    assert first == written[0][1]
    counts = {name.removeprefix("/"): n for name, n in found.counts.items() if n}
    assert counts == dict(Counter(m[0] for m in saved))
    assert not found.has_result


@pytest.mark.parametrize("storage", STORAGES)
def test_a_process_that_is_killed_leaves_what_it_has_brought_to_the_disk(
    tmp_path: Path, trial: SyntheticTrial, storage: str
) -> None:
    """The same by a real SIGKILL, in the middle of a chunk."""
    written = recorded_order(trial)[:250]
    recording = RecordingConfig(storage=storage, chunk_s=CHUNK_S)  # type: ignore[arg-type]
    process = os.fork()
    if process == 0:
        try:
            writer = TrialBagWriter(tmp_path / "trial_003", METADATA, recording)
            for message in written:
                writer.write(*message)
        finally:
            os.kill(os.getpid(), signal.SIGKILL)
    _, status = os.waitpid(process, 0)
    assert os.WTERMSIG(status) == signal.SIGKILL
    saved = contents(recover(tmp_path / UNFINISHED / "trial_003").bag)
    assert sorted(saved) == sorted(written[: len(saved)])
    assert len(written) - len(saved) <= 3 * round(CHUNK_S * NS_PER_S / PERIOD_NS)


def test_a_file_that_ends_at_any_byte_gives_its_whole_chunks(tmp_path: Path, trial: SyntheticTrial) -> None:
    """What a power cut leaves: the file is as long as the disk says, or its end is zeros or noise."""
    written = recorded_order(trial)
    unfinished = interrupted(tmp_path, "mcap", written[:300])
    file = unfinished / "trial_003.mcap"
    data = file.read_bytes()
    rng = np.random.default_rng(0)
    n_saved = []
    for k, end in enumerate(sorted(rng.integers(4000, len(data), 6).tolist())):
        zeros, noise = bytes(len(data) - end), rng.bytes(len(data) - end)
        for tail in (b"", zeros, noise):
            file.write_bytes(data[:end] + tail)
            out = tmp_path / f"out_{k}_{len(n_saved)}"
            try:
                saved = contents(recover(unfinished, out).bag)
            except BagError as error:
                assert "holds no whole chunk" in str(error)
                saved = []
            assert sorted(saved) == sorted(written[: len(saved)])
            n_saved.append(len(saved))
    assert n_saved == sorted(n_saved), "a longer file holds no fewer messages, whatever stands behind its end"
    assert n_saved[0] < n_saved[-1]


@pytest.mark.parametrize("storage", STORAGES)
def test_what_is_recovered_is_marked_and_never_trained_on(
    tmp_path: Path, trial: SyntheticTrial, storage: str
) -> None:
    bag = recover(interrupted(tmp_path, storage, recorded_order(trial)[:300])).bag
    assert bag == tmp_path / "run" / "recovered" / "trial_003"
    information = yaml.safe_load((bag / "metadata.yaml").read_text(encoding="utf-8"))
    custom = information["rosbag2_bagfile_information"]["custom_data"]
    assert custom == METADATA | {RECOVERED: custom[RECOVERED]}
    for read in (read_trial, check_bag):
        with pytest.raises(
            BagError, match="was recovered after a crash .*; expected a bag that was recorded to"
        ):
            read(bag)


@pytest.mark.parametrize("storage", STORAGES)
def test_who_asks_for_it_can_look_at_what_was_recovered(
    tmp_path: Path, trial: SyntheticTrial, storage: str
) -> None:
    found = read_trial(
        recover(interrupted(tmp_path, storage, recorded_order(trial)[:300])).bag, recovered=True
    )
    n = len(found.time_ns)
    assert 80 <= n <= 100
    np.testing.assert_array_equal(found.position_rad, trial.values["position_rad"][:n])
    assert (found.report.index, found.report.outcome) == (3, Outcome.ABORTED)
    assert "recording has no end" in found.report.message


@pytest.mark.parametrize("storage", STORAGES)
def test_even_a_recording_that_only_lacked_its_name_is_marked(
    tmp_path: Path, trial: SyntheticTrial, storage: str
) -> None:
    """Killed between the last byte and the renaming: everything is there, but nobody has checked it."""
    bag = trial.write(tmp_path / "trial_003", recording=RecordingConfig(storage=storage))  # type: ignore[arg-type]
    unfinished = tmp_path / UNFINISHED / "trial_003"
    unfinished.parent.mkdir()
    bag.rename(unfinished)
    found = recover(unfinished)
    assert found.has_result and found.files[0].lost_bytes >= 0
    assert sorted(contents(found.bag)) == sorted(trial.messages())
    with pytest.raises(BagError, match="was recovered after a crash"):
        read_trial(found.bag)
    assert read_trial(found.bag, recovered=True).report.outcome == Outcome.COMPLETED


def test_the_recording_stays_as_it_is_and_nothing_is_overwritten(
    tmp_path: Path, trial: SyntheticTrial
) -> None:
    unfinished = interrupted(tmp_path, "sqlite3", recorded_order(trial)[:300])
    before = {file.name: file.read_bytes() for file in unfinished.iterdir()}
    recover(unfinished)
    with pytest.raises(BagError, match="recovered/trial_003: exists already; expected a name that is free"):
        recover(unfinished)
    assert {file.name: file.read_bytes() for file in unfinished.iterdir()} == before


def test_a_transaction_that_did_not_end_is_taken_back(tmp_path: Path, trial: SyntheticTrial) -> None:
    """A long one has already changed pages of the database itself: its journal tells what they were."""
    recording = RecordingConfig(storage="sqlite3", chunk_s=1e6)
    writer = TrialBagWriter(tmp_path / "trial_003", METADATA, recording)
    writer.write(*recorded_order(trial)[0])
    writer.flush()
    storage = writer._writer.storage
    storage.conn.execute("PRAGMA cache_size = 1")  # type: ignore[union-attr]
    for message in recorded_order(trial)[1:300]:
        writer.write(*message)
    unfinished = tmp_path / "crashed" / UNFINISHED / "trial_003"
    shutil.copytree(tmp_path / UNFINISHED / "trial_003", unfinished)
    writer.abandon()
    assert (unfinished / "trial_003.db3-journal").stat().st_size > 0
    found = recover(unfinished)
    assert [m[0] for m in contents(found.bag)] == [topics.TRIAL_GOAL]
    assert found.files[0].lost_bytes > 0


@pytest.mark.parametrize("text", [None, "", "- a\n- b", "a: [", "\x00"])
def test_without_a_readable_configuration_the_messages_are_still_saved(
    tmp_path: Path, trial: SyntheticTrial, text: str | None
) -> None:
    unfinished = interrupted(tmp_path, "mcap", recorded_order(trial)[:300])
    file = unfinished / CUSTOM_DATA_FILE
    file.unlink() if text is None else file.write_text(text, encoding="utf-8")
    found = recover(unfinished)
    assert found.counts[f"/{topics.CONTROL_STATES}"] > 50
    assert read_trial(found.bag, recovered=True).metadata.keys() == {RECOVERED}


def test_what_holds_nothing_is_refused(tmp_path: Path, trial: SyntheticTrial) -> None:
    with pytest.raises(
        BagError, match="trial_009: there is no such file or folder; expected the folder of a recording"
    ):
        recover(tmp_path / UNFINISHED / "trial_009")
    (tmp_path / "empty").mkdir()
    with pytest.raises(BagError, match="empty: is a folder without metadata.yaml and data files"):
        recover(tmp_path / "empty")
    for storage, said in (
        ("mcap", "holds no whole chunk"),
        ("sqlite3", "holds no transaction that has ended"),
    ):
        with pytest.raises(BagError, match=said):
            recover(interrupted(tmp_path / storage, storage, recorded_order(trial)[:5]))
        file = next((tmp_path / storage / "run" / UNFINISHED / "trial_003").glob("trial_003.*"))
        file.write_bytes(b"something else" * 100)
        with pytest.raises(BagError, match=rf"{file.name}: .*; expected"):
            recover(file.parent)
    for file in (tmp_path / "sqlite3" / "run" / UNFINISHED / "trial_003").glob("*.db3"):
        file.write_bytes(b"")  # killed before the tables were made
        with pytest.raises(BagError, match="holds no transaction that has ended"):
            recover(file.parent)
    with pytest.raises(BagError, match="is whole: there is nothing to recover"):
        recover(trial.write(tmp_path / "whole"))


def split(folder: Path, storage: str, names: Sequence[str], trial: SyntheticTrial) -> Path:
    """Write the messages of a trial into several data files without metadata, as a recorder splits them."""
    folder.mkdir()
    messages = recorded_order(trial)
    step = len(messages) // len(names) + 1
    for k, name in enumerate(names):
        part = folder.parent / f"part_{k}"
        with TrialBagWriter(part, {}, RecordingConfig(storage=storage, chunk_s=0.02)) as writer:  # type: ignore[arg-type]
            for message in messages[k * step : (k + 1) * step]:
                writer.write(*message)
        (data,) = (file for file in part.iterdir() if file.suffix in (".mcap", ".db3"))
        data.rename(folder / f"{name}{data.suffix}")
    return folder


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
@pytest.mark.parametrize("names", [("a", "b"), ("z", *map(str, range(1, 11)))])
def test_all_files_of_a_recording_are_saved(
    tmp_path: Path, trial: SyntheticTrial, storage: str, names: Sequence[str]
) -> None:
    """In the order of time, whatever their names."""
    found = recover(split(tmp_path / "bag", storage, names, trial))
    assert [(file.whole, file.lost_bytes) for file in found.files] == [(True, 0)] * len(names)
    assert sum(file.messages for file in found.files) == len(recorded_order(trial))
    saved = contents(found.bag)
    assert len(saved) == len(recorded_order(trial))
    assert [time_ns for _, time_ns, _ in saved] == sorted(time_ns for _, time_ns, _ in recorded_order(trial))


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_what_each_file_has_lost_is_told(tmp_path: Path, trial: SyntheticTrial, storage: str) -> None:
    bag = split(tmp_path / "bag", storage, "abcd", trial)
    kind = ".mcap" if storage == "mcap" else ".db3"
    whole = (bag / f"b{kind}").read_bytes()
    (bag / f"b{kind}").write_bytes(whole[: len(whole) * 2 // 3])
    (bag / f"c{kind}").write_bytes(b"nothing of the kind")
    found = recover(bag)
    a, b, c, d = found.files
    assert (a.whole, a.lost_bytes, d.whole, d.lost_bytes) == (True, 0, True, 0)
    assert not b.whole
    assert 0 < b.messages <= len(recorded_order(trial)) // 4 + 1
    assert (c.messages, c.lost_bytes) == (0, len(b"nothing of the kind"))
    assert c.problem
    assert len(contents(found.bag)) == a.messages + b.messages + d.messages


@pytest.mark.parametrize("named", [["a.mcap"], ["x.mcap", "y.mcap"]])
def test_metadata_that_name_fewer_files_or_others_hide_none(
    tmp_path: Path, trial: SyntheticTrial, named: list[str]
) -> None:
    bag = split(tmp_path / "bag", "mcap", "ab", trial)
    content = yaml.safe_load((tmp_path / "part_0" / "metadata.yaml").read_text())
    content["rosbag2_bagfile_information"]["relative_file_paths"] = named
    (bag / "metadata.yaml").write_text(yaml.safe_dump(content))
    assert len(contents(recover(bag).bag)) == len(recorded_order(trial))


def test_a_data_file_by_itself_is_recovered_and_a_whole_one_is_not(
    tmp_path: Path, trial: SyntheticTrial
) -> None:
    file = split(tmp_path / "bag", "mcap", "a", trial) / "a.mcap"
    with pytest.raises(BagError, match="is whole: there is nothing to recover"):
        recover(file)
    file.write_bytes(file.read_bytes()[:-100])
    found = recover(file)
    assert found.bag == tmp_path / "bag" / "a_recovered"
    assert len(contents(found.bag)) == len(recorded_order(trial))


def test_a_damaged_chunk_costs_its_messages_and_no_others(tmp_path: Path, trial: SyntheticTrial) -> None:
    bag = split(tmp_path / "bag", "mcap", "a", trial)
    data = bytearray((bag / "a.mcap").read_bytes())
    data[len(data) // 3 : len(data) // 3 + 500] = b"\xff" * 500
    (bag / "a.mcap").write_bytes(data)
    found = recover(bag)
    (file,) = found.files
    assert not file.whole
    assert file.lost_bytes > 0
    assert max(time_ns for _, time_ns, _ in contents(found.bag)) == max(
        row[1] for row in recorded_order(trial)
    )
