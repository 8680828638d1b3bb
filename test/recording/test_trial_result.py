"""The loop's figures in a bag, and bags from before there were any."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from synthetic_trial import SyntheticTrial

from tel_ros.core.trial import LoopTiming
from tel_ros.recording import topics
from tel_ros.recording.bag_format import typestore
from tel_ros.recording.bag_writer import TrialBagWriter
from tel_ros.recording.shared_files import share_folder
from tel_ros.recording.trial_bag import read_trial
from tel_ros.recording.trial_result import timing_fields

SAMPLE_RUN = Path(__file__).parents[2] / "bags" / "sample_run"
TIMING = LoopTiming(
    state_rate_hz=499.5,
    stamp_rate_hz=500.0,
    jitter_p50_s=1e-5,
    jitter_p99_s=2e-4,
    jitter_max_s=3e-3,
    response_p99_s=4e-4,
    response_max_s=5e-4,
    missed_ticks=2,
    warning="a state was late",
)


def test_what_was_measured_comes_back_from_the_bag(tmp_path: Path, trial: SyntheticTrial) -> None:
    trial.timing = TIMING
    assert read_trial(trial.write(tmp_path / "bag")).report.timing == TIMING


def test_a_trial_that_was_not_measured_says_so(trial_bag: Path) -> None:
    assert read_trial(trial_bag).report.timing is None


@pytest.mark.parametrize("name", ["trial_001", "trial_002"])
def test_the_sample_bags_were_made_in_lockstep_and_have_no_figures(name: str) -> None:
    trial = read_trial(SAMPLE_RUN / name)
    assert trial.report.timing is None
    assert len(trial.time_ns) > 1000


def test_a_bag_from_before_results_had_figures_is_read(
    tmp_path: Path, trial: SyntheticTrial, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A bag carries the definitions of its messages: its result has no such fields."""
    kind, newer = topics.RECORDED_ONCE[topics.TRIAL_RESULT], timing_fields(None)
    older = get_typestore(Stores.ROS2_JAZZY)
    for file in (share_folder("tel_interfaces") / "msg").glob("*.msg"):
        lines = file.read_text(encoding="utf-8").splitlines()
        lines = [line for line in lines if line.partition("#")[0].split()[1:2] not in ([n] for n in newer)]
        older.register(get_types_from_msg("\n".join(lines), f"tel_interfaces/msg/{file.stem}"))
    assert len(older.fielddefs[kind][1]) == len(typestore().fielddefs[kind][1]) - len(newer)
    monkeypatch.setattr("tel_ros.recording.bag_format.typestore", lambda: older)
    trial.timing = TIMING
    with TrialBagWriter(tmp_path / "bag", {}) as writer:
        for topic, time_ns, data in trial.messages():
            if topic == topics.TRIAL_RESULT:
                result = vars(typestore().deserialize_cdr(data, kind))
                fields = {k: v for k, v in result.items() if k not in (*newer, "__msgtype__")}
                data = bytes(older.serialize_cdr(older.types[kind](**fields), kind))
            writer.write(topic, time_ns, data)
    assert read_trial(tmp_path / "bag").report.timing is None


def test_every_figure_has_a_field_of_its_own() -> None:
    figures = {field.name for field in dataclasses.fields(LoopTiming)} - {"warning"}
    assert set(timing_fields(TIMING)) == set(timing_fields(None)) == figures | {"timing_warning"}
