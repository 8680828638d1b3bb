"""What a bag holds, and whether it is whole."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from rosbags.rosbag2 import StoragePlugin
from small_bags import MCAP, SQLITE3, STATES, TEXT, joint_state, text, write_bag
from synthetic_trial import JOINTS, METADATA, SyntheticTrial

from tel_ros.core.errors import BagError
from tel_ros.recording import topics
from tel_ros.recording.bag_inspection import Wholeness, bags_of_run, inspect_bag
from tel_ros.recording.bag_writer import UNFINISHED, TrialBagWriter

SECOND_NS = 1_000_000_000
ROWS = [("/states", STATES, k * SECOND_NS, joint_state(k, ["a"], [0.0])) for k in (1, 2, 4)]
ROWS.append(("/note", TEXT, 3 * SECOND_NS, text("x")))


def test_a_trial_is_told_with_its_result_its_topics_and_what_was_stored_with_it(
    trial_bag: Path, trial: SyntheticTrial
) -> None:
    found = inspect_bag(trial_bag)
    total = trial.n + trial.extra_ticks
    assert (found.wholeness, found.problem) == (Wholeness.WHOLE, "")
    assert (found.storage, found.version, found.metadata) == ("mcap", 9, METADATA)
    assert (found.start_ns, found.n_messages) == (trial.start_ns, 3 * total + 2)
    assert found.duration_s == pytest.approx((total - 1) * 0.002)
    assert found.size_bytes == sum(file.stat().st_size for file in trial_bag.iterdir())
    by_name = {topic.name: topic for topic in found.topics}
    states, goal = by_name[f"/{topics.JOINT_STATES}"], by_name[f"/{topics.TRIAL_GOAL}"]
    assert (states.announced, states.found, states.latched) == (total, total, False)
    assert states.rate_hz == pytest.approx(500.0)
    assert states.longest_gap_s == pytest.approx(0.002)
    assert (goal.found, goal.latched, math.isnan(goal.rate_hz)) == (1, True, True)
    assert found.trial is not None
    assert (found.trial.index, found.trial.outcome.text, found.joints) == (3, "completed", JOINTS)
    assert (found.trial.ticks, found.trial.duration_s, found.trial.rms_error_rad) == (trial.n, 9.0, 0.1)


def test_a_trial_that_was_aborted_says_why(tmp_path: Path) -> None:
    found = inspect_bag(SyntheticTrial(outcome=1, message="elbow is off").write(tmp_path / "bag")).trial
    assert found is not None
    assert (found.outcome.text, found.message) == ("aborted", "elbow is off")


@pytest.mark.parametrize(("storage", "name"), [(MCAP, "mcap"), (SQLITE3, "sqlite3")])
def test_a_bag_of_another_recorder_is_complete_as_far_as_anybody_knows(
    tmp_path: Path, storage: StoragePlugin, name: str
) -> None:
    bag = write_bag(tmp_path / "bag", ROWS, storage)
    found = inspect_bag(bag)
    assert (found.wholeness, found.storage, found.trial, found.duration_s) == (
        Wholeness.COMPLETE,
        name,
        None,
        3.0,
    )
    states = found.topics[1]
    assert (states.name, states.longest_gap_s) == ("/states", 2.0)
    assert states.rate_hz == pytest.approx(2 / 3)
    (file,) = (file for file in bag.iterdir() if file.suffix != ".yaml")
    alone = inspect_bag(file)
    assert (alone.n_messages, alone.version, alone.wholeness) == (4, None, Wholeness.COMPLETE)


def test_data_that_have_changed_are_noticed_although_they_can_be_read(trial_bag: Path) -> None:
    sums = trial_bag / "SHA256SUMS"
    sums.write_text("0" * 64 + sums.read_text()[64:], encoding="utf-8")
    found = inspect_bag(trial_bag)
    assert found.wholeness is Wholeness.BROKEN
    assert "has changed since it was recorded" in found.problem


def test_checksums_of_a_file_that_is_gone_do_not_count_as_checked(trial_bag: Path) -> None:
    (trial_bag / "SHA256SUMS").write_text(f"{'0' * 64}  other.mcap\n", encoding="utf-8")
    found = inspect_bag(trial_bag)
    assert found.wholeness is Wholeness.BROKEN
    assert "other.mcap" in found.problem


def test_damaged_data_are_told_and_not_raised(trial_bag: Path) -> None:
    (file,) = trial_bag.glob("*.mcap")
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    found = inspect_bag(trial_bag)
    assert (found.wholeness, found.topics) == (Wholeness.BROKEN, ())
    assert "cannot be read" in found.problem
    assert found.metadata == METADATA


def test_messages_that_are_announced_and_do_not_come_are_counted(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", ROWS)
    metadata = bag / "metadata.yaml"
    text_of = metadata.read_text(encoding="utf-8")
    assert "- message_count: 3\n" in text_of
    metadata.write_text(text_of.replace("- message_count: 3\n", "- message_count: 20\n"), encoding="utf-8")
    found = inspect_bag(bag)
    assert found.wholeness is Wholeness.BROKEN
    assert found.problem == "it yields 3 messages of /states instead of 20"


def test_a_recording_that_was_never_closed_is_unfinished(tmp_path: Path, trial: SyntheticTrial) -> None:
    writer = TrialBagWriter(tmp_path / "trial_003", {})
    for topic, time_ns, data in trial.messages():
        writer.write(topic, time_ns, data)
    writer.abandon()
    (left,) = bags_of_run(tmp_path)
    found = inspect_bag(left)
    assert (found.wholeness, left.parent.name) == (Wholeness.UNFINISHED, UNFINISHED)
    assert "tel bag recover" in found.problem
    assert found.size_bytes > 0


def test_a_closed_bag_among_the_unfinished_ones_is_one_of_them(tmp_path: Path, trial: SyntheticTrial) -> None:
    bag = trial.write(tmp_path / UNFINISHED / "trial_003")
    assert inspect_bag(bag).wholeness is Wholeness.UNFINISHED


def test_a_recovered_bag_is_named_so(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", ROWS, custom={"recovered": "from .unfinished/trial_003"})
    found = inspect_bag(bag)
    assert (found.wholeness, found.problem) == (
        Wholeness.RECOVERED,
        "recovered: from .unfinished/trial_003",
    )


def test_what_is_no_bag_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BagError, match="there is no such file or folder"):
        inspect_bag(tmp_path / "nothing")
    with pytest.raises(BagError, match="is a folder without metadata.yaml and data files"):
        inspect_bag(tmp_path)


def test_the_bags_of_a_run_are_its_trials_and_what_was_never_finished_or_recovered(tmp_path: Path) -> None:
    for name in ("trial_002", "trial_001", "network", "recovered/trial_003", f"{UNFINISHED}/trial_003"):
        (tmp_path / name).mkdir(parents=True)
    assert [bag.relative_to(tmp_path).as_posix() for bag in bags_of_run(tmp_path)] == [
        "trial_001",
        "trial_002",
        f"{UNFINISHED}/trial_003",
        "recovered/trial_003",
    ]
