"""The summary of a run, as scripts read it."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest

from tel_ros.core.config import Config
from tel_ros.core.learning.learner import TrainingOutcome
from tel_ros.core.practice.session import PractisedTrial
from tel_ros.core.practice.strategy import Movement, PlannedTrial
from tel_ros.core.trial import LoopTiming, Outcome, TrialReport
from tel_ros.recording.config_file import to_plain
from tel_ros.recording.run_folder import json_ready, read_summary
from tel_ros.recording.summary import RunSummary, TrialRow

RUN_KEYS = {"run", "config", "outcome", "trials"}
TRIAL_KEYS = {
    "index",
    "alpha",
    "duration_s",
    "rms_error_rad",
    "rms_error_per_joint_rad",
    "max_error_rad",
    "rms_command_change_rad",
    "training_rms_before_rad",
    "training_rms_after_rad",
    "outcome",
    "bag",
    "wall_s",
}
"""What scripts rely on; there may be more."""


def report(index: int = 1, outcome: Outcome = Outcome.COMPLETED, error_rad: float = 0.07) -> TrialReport:
    return TrialReport(
        index=index,
        alpha=0.4,
        duration_s=11.5,
        outcome=outcome,
        message="" if outcome == Outcome.COMPLETED else "elbow is off",
        start_ns=1,
        run_ns=2,
        end_ns=3,
        ticks=5000,
        rms_error_rad=error_rad,
        rms_error_per_joint_rad=np.array([error_rad, 0.05]),
        max_error_rad=0.2,
        max_effort_nm=np.array([4.0, 2.0]),
        saturated_ratio=0.0,
    )


def plan(index: int = 1) -> PlannedTrial:
    """Return what was planned for a trial: back to the network of the second, with nothing expected."""
    return PlannedTrial(index, 0.5, Movement(9.0), go_back_to=2, reason="a try")


def row(trial: TrialReport, training: TrainingOutcome | None = None, bag: str = "trial_001") -> TrialRow:
    done = PractisedTrial(plan(trial.index), trial, None, training)
    return TrialRow.of(done, bag, 3.5)


@pytest.fixture
def summary(tmp_path: Path, config: Config) -> RunSummary:
    """Of a run in a folder ``monday``."""
    (tmp_path / "monday").mkdir()
    return RunSummary(tmp_path / "monday", config)


def test_a_summary_has_the_keys_that_scripts_rely_on(
    summary: RunSummary, tmp_path: Path, config: Config
) -> None:
    summary.add(row(report(), TrainingOutcome(0.4, 0.1, 0.2, ("elbow: subtree 1",))))
    found = read_summary(tmp_path / "monday")
    assert set(found) >= RUN_KEYS
    assert found["run"] == "monday"
    assert found["config"] == to_plain(config)
    (trial,) = found["trials"]
    assert set(trial) >= TRIAL_KEYS
    assert trial["rms_error_per_joint_rad"] == [0.07, 0.05]
    assert (trial["outcome"], trial["bag"], trial["wall_s"]) == ("completed", "trial_001", 3.5)
    training = [f"training_rms_{when}_rad" for when in ("before", "after")]
    assert [trial[key] for key in training] == [0.4, 0.1]
    assert trial["rms_command_change_rad"] == 0.2
    assert trial["ticks"] == 5000
    assert (trial["reason"], trial["went_back_to"], trial["expected_rms_rad"]) == ("a try", 2, None)


def test_it_is_on_the_disk_after_each_trial(summary: RunSummary, tmp_path: Path) -> None:
    for index in (1, 2, 3):
        summary.add(row(report(index), bag=f"trial_{index:03d}"))
        found = read_summary(tmp_path / "monday")
        assert [trial["index"] for trial in found["trials"]] == list(range(1, index + 1))
        assert found["outcome"] == "running"


def test_the_end_of_a_run_is_written_too(summary: RunSummary, tmp_path: Path) -> None:
    summary.add(row(report()))
    summary.end("aborted", "trial 2 was aborted")
    found = read_summary(tmp_path / "monday")
    assert (found["outcome"], found["message"]) == ("aborted", "trial 2 was aborted")
    assert len(found["trials"]) == 1


def test_a_trial_without_a_run_and_without_training_has_null_for_their_numbers(
    summary: RunSummary, tmp_path: Path
) -> None:
    summary.add(row(report(outcome=Outcome.ABORTED, error_rad=float("nan"))))
    (trial,) = read_summary(tmp_path / "monday")["trials"]
    assert trial["rms_error_rad"] is None
    assert trial["rms_error_per_joint_rad"] == [None, 0.05]
    assert trial["training_rms_before_rad"] is trial["training_rms_after_rad"] is None
    assert (trial["outcome"], trial["message"], trial["bag"]) == ("aborted", "elbow is off", "trial_001")


def test_a_run_that_failed_before_its_first_trial_has_a_summary(summary: RunSummary, tmp_path: Path) -> None:
    summary.end("failed", "the arm is not there")
    found = read_summary(tmp_path / "monday")
    assert (found["outcome"], found["trials"]) == ("failed", [])


def test_the_loops_figures_stand_in_the_summary_only_where_they_were_measured(
    summary: RunSummary, tmp_path: Path
) -> None:
    timing = LoopTiming(
        state_rate_hz=499.5,
        stamp_rate_hz=float("nan"),
        jitter_p50_s=1e-5,
        jitter_p99_s=2e-4,
        jitter_max_s=3e-3,
        response_p99_s=4e-4,
        response_max_s=5e-4,
        missed_ticks=2,
        warning="a state was late",
    )
    summary.add(row(report(1)))
    summary.add(row(replace(report(2), timing=timing)))
    first, second = (trial["timing"] for trial in read_summary(tmp_path / "monday")["trials"])
    assert first is None
    assert second == {**asdict(timing), "stamp_rate_hz": None}


def test_a_row_comes_back_from_the_summary_as_it_was(summary: RunSummary, tmp_path: Path) -> None:
    written = row(report(), TrainingOutcome(0.4, 0.1, 0.2, ("elbow: subtree 1",)))
    summary.add(written)
    (values,) = read_summary(tmp_path / "monday")["trials"]
    found = TrialRow.from_plain(values)
    assert json_ready(found.to_plain()) == json_ready(written.to_plain())
    assert (found.outcome, found.grown) == (Outcome.COMPLETED, ("elbow: subtree 1",))


def test_a_row_of_an_earlier_version_lacks_what_came_later_but_not_what_always_was(config: Config) -> None:
    values = row(report()).to_plain()
    older = {key: value for key, value in values.items() if key not in ("reason", "warning", "timing")}
    assert TrialRow.from_plain(older).warning == ""
    with pytest.raises(KeyError, match="rms_error_rad"):
        TrialRow.from_plain({key: value for key, value in values.items() if key != "rms_error_rad"})
