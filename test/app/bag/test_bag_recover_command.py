"""``tel bag recover``, as typed."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from tel_ros.app.cli import main
from tel_ros.app.errors import EXIT_BAD_INPUT
from tel_ros.core.errors import BagError
from tel_ros.core.types import NS_PER_S
from tel_ros.recording import topics
from tel_ros.recording.bag_format import typestore
from tel_ros.recording.bag_writer import UNFINISHED, TrialBagWriter
from tel_ros.recording.trial_bag import read_trial


@pytest.fixture
def unfinished(tmp_path: Path) -> Path:
    """A recording with 20 control states that was never closed."""
    store, kind = typestore(), topics.RECORDED_LIVE[topics.JOINT_STATES]
    writer = TrialBagWriter(tmp_path / "run" / "trial_002", {"seed": "7"})
    for k in range(20):
        stamp = store.types["builtin_interfaces/msg/Time"](sec=k, nanosec=0)
        header = store.types["std_msgs/msg/Header"](stamp=stamp, frame_id="")
        values = dict.fromkeys(("position", "velocity", "effort"), np.zeros(0))
        message = store.types[kind](header=header, name=[], **values)
        writer.write(topics.JOINT_STATES, k * NS_PER_S, bytes(store.serialize_cdr(message, kind)))
    writer.abandon()
    return tmp_path / "run" / UNFINISHED / "trial_002"


def test_it_says_what_was_saved_and_where(unfinished: Path, tmp_path: Path) -> None:
    done = CliRunner().invoke(main, ["bag", "recover", str(unfinished)])
    assert done.exit_code == 0, done.output
    bag = tmp_path / "run" / "recovered" / "trial_002"
    lines = done.output.splitlines()
    assert lines[0].split() == ["20", f"/{topics.JOINT_STATES}"]
    assert lines[-3:] == [
        "trial_002.mcap: 20 messages saved, nothing is lost (it was not closed, or is damaged)",
        "the end of the trial is missing",
        f"recovered into {bag}, from {unfinished}",
    ]
    with pytest.raises(BagError, match="was recovered after a crash"):
        read_trial(bag)


def test_json_tells_what_was_saved(unfinished: Path, tmp_path: Path) -> None:
    said = json.loads(CliRunner().invoke(main, ["bag", "recover", str(unfinished), "--json"]).output)
    assert said["bag"] == str(tmp_path / "run" / "recovered" / "trial_002")
    assert said["counts"][f"/{topics.JOINT_STATES}"] == 20
    assert (said["lost_bytes"], said["has_result"]) == (0, False)


def test_the_new_bag_can_be_put_elsewhere(unfinished: Path, tmp_path: Path) -> None:
    out = tmp_path / "elsewhere" / "bag"
    assert CliRunner().invoke(main, ["bag", "recover", str(unfinished), "--out", str(out)]).exit_code == 0
    assert (out / "metadata.yaml").is_file()


def test_a_second_time_is_refused_in_one_line(unfinished: Path) -> None:
    assert CliRunner().invoke(main, ["bag", "recover", str(unfinished)]).exit_code == 0
    again = CliRunner().invoke(main, ["bag", "recover", str(unfinished)])
    assert again.exit_code == EXIT_BAD_INPUT
    assert again.output.startswith("tel: ") and again.output.count("\n") == 1
    assert "exists already" in again.output
