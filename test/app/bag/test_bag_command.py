"""``tel bag info``, ``tel bag plot``, and what ``tel replay`` refuses before anything is published."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result
from made_up_run import MakeRun, Trial, trials
from matplotlib.image import imread
from rosbags.rosbag2 import Writer

from tel_ros.app.cli import main
from tel_ros.recording.bag_format import typestore

SAMPLE = Path(__file__).parents[3] / "bags" / "sample_run"
STATES = "sensor_msgs/msg/JointState"


def tel(*arguments: object) -> Result:
    return CliRunner().invoke(main, [str(argument) for argument in arguments])


@pytest.fixture
def foreign(tmp_path: Path) -> Path:
    """A bag of another recorder: three joint states of two joints, with velocities."""
    types, store = typestore().types, typestore()
    with Writer(tmp_path / "foreign", version=9) as writer:
        connection = writer.add_connection("/states", STATES, typestore=store)
        for k in range(3):
            header = types["std_msgs/msg/Header"](
                stamp=types["builtin_interfaces/msg/Time"](sec=k, nanosec=0), frame_id=""
            )
            array = np.array([0.1 * k, 0.2])
            state = types[STATES](
                header=header, name=["a", "b"], position=array, velocity=array, effort=array[:0]
            )
            writer.write(connection, k * 10**9, store.serialize_cdr(state, STATES))
    return tmp_path / "foreign"


def test_info_tells_a_person_what_a_trial_came_to() -> None:
    result = tel("bag", "info", SAMPLE / "trial_001")
    assert result.exit_code == 0, result.output
    lines = result.output.splitlines()
    for line in (
        "state             whole: its data are as they were recorded",
        "time              9.638 s from 0.000 s (no time of day: that of a simulation)",
        "network_revision  1c9023a4d7b9e82a",
    ):
        assert line in lines
    (states,) = (line.split() for line in lines if "/joint_states" in line)
    assert states == ["/joint_states", "sensor_msgs/msg/JointState", "4820", "500", "0.00200"]


def test_info_tells_a_script_the_same() -> None:
    told = json.loads(tel("bag", "info", SAMPLE / "trial_001", "--json").output)
    assert (told["wholeness"], told["is_good"], told["n_messages"]) == ("whole", True, 14460)
    assert told["metadata"]["seed"] == "1"
    assert told["metadata"]["config"].startswith("arm:\n")
    assert told["trial"]["outcome"] == "completed"
    by_name = {topic["name"]: topic for topic in told["topics"]}
    assert by_name["/practice/trial_goal"]["rate_hz"] is None


def test_info_of_a_run_has_a_row_a_trial_and_names_what_is_wrong(make_run: MakeRun) -> None:
    run = make_run(trials(3))
    assert tel("bag", "info", run).exit_code == 0
    (run / "trial_002" / "metadata.yaml").unlink()
    result = tel("bag", "info", run)
    assert result.exit_code == 1
    rows = [line.split() for line in result.output.splitlines()]
    assert [row[:2] for row in rows if row and row[0].startswith("trial_")][:3] == [
        ["trial_001", "whole"],
        ["trial_002", "unfinished"],
        ["trial_003", "whole"],
    ]
    assert "trial_002  unfinished: it was never closed" in result.output
    told = json.loads(tel("bag", "info", run, "--json").output)
    assert [bag["is_good"] for bag in told["bags"]] == [True, False, True]


def test_info_works_on_the_bags_of_others(foreign: Path) -> None:
    result = tel("bag", "info", foreign)
    assert result.exit_code == 0, result.output
    assert "storage           sqlite3, rosbag2 version 9" in result.output
    assert "trial  " not in result.output


@pytest.mark.parametrize("command", ["info", "plot"])
def test_what_is_no_bag_is_refused_in_one_line(tmp_path: Path, command: str) -> None:
    for path in (tmp_path, tmp_path / "nothing"):
        result = tel("bag", command, path)
        assert result.exit_code == 2
        assert str(path) in result.stderr
        assert result.stderr.count("\n") == 1


def test_a_run_without_trials_is_refused(make_run: MakeRun) -> None:
    run = make_run(trials(1))
    shutil.rmtree(run / "trial_001")
    result = tel("bag", "info", run)
    assert (result.exit_code, "has no trial" in result.stderr) == (2, True)


@pytest.mark.parametrize(
    ("ending", "beginning"),
    [("png", b"\x89PNG"), ("svg", b"<?xml"), ("pdf", b"%PDF"), ("html", b"<!DOCTYPE")],
)
def test_a_trial_is_drawn_into_a_file_of_each_kind(tmp_path: Path, ending: str, beginning: bytes) -> None:
    out = tmp_path / f"figure.{ending}"
    result = tel("bag", "plot", SAMPLE / "trial_002", "--out", out)
    assert (result.exit_code, result.output, result.stderr) == (0, f"{out}\n", "")
    content = out.read_bytes()
    assert content.startswith(beginning)
    if ending in ("svg", "html"):
        text = content.decode()
        for words in ("shoulder", "elbow", "equilibrium point (EP)", "limit", "torque [N·m]", "trial 2"):
            assert words in text
    assert [file.name for file in tmp_path.iterdir()] == [out.name]


def test_equal_bags_give_equal_figures(tmp_path: Path) -> None:
    files = [tmp_path / name for name in ("one.svg", "two.svg")]
    for file in files:
        assert tel("bag", "plot", SAMPLE / "trial_002", "--out", file).exit_code == 0
    assert files[0].read_bytes() == files[1].read_bytes()


def test_the_bags_of_others_are_drawn_without_what_they_do_not_tell(foreign: Path, tmp_path: Path) -> None:
    out = tmp_path / "figure.svg"
    result = tel("bag", "plot", foreign, "--out", out)
    assert (result.exit_code, result.stderr) == (0, "")
    text = out.read_text(encoding="utf-8")
    assert "position [rad]" in text
    assert "velocity [rad/s]" in text
    assert "effort" not in text


def test_the_figure_lies_in_the_current_folder_unless_told_otherwise(
    foreign: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "here"
    folder.mkdir()
    monkeypatch.chdir(folder)
    assert tel("bag", "plot", foreign).output == "foreign.png\n"
    assert imread(folder / "foreign.png").shape[1] == 2100


def test_a_trial_without_a_usable_configuration_is_drawn_without_limits_and_says_so(
    make_run: MakeRun, tmp_path: Path
) -> None:
    out = tmp_path / "figure.svg"
    result = tel("bag", "plot", make_run([Trial()]) / "trial_001", "--out", out)
    assert result.exit_code == 0
    assert "no effort limits" in result.stderr
    assert "limit" not in out.read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--out", "figure.gif"), "ends in .gif; expected an ending .png, .svg, .pdf, .html"),
        (("--out", "nowhere/figure.png"), "cannot be written (No such file or directory)"),
        (("--topic", "/elbow"), "has no joint states on /elbow"),
    ],
)
def test_what_cannot_be_drawn_is_refused(arguments: tuple[str, ...], said: str) -> None:
    result = tel("bag", "plot", SAMPLE / "trial_002", *arguments)
    assert result.exit_code == 2
    assert said in result.stderr


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--rate", "0"), "rate is 0.0; expected a finite number above 0"),
        (("--start-offset", "60"), "start-offset is 60.0; expected less than the bag's 4.674 s"),
        (("--topics", "/elbow"), "has no topic /elbow"),
        (("--states-to-nodes", "--topics", "/practice/*"), "has these topics of joint states: none"),
    ],
)
def test_a_replay_that_makes_no_sense_is_refused(arguments: tuple[str, ...], said: str) -> None:
    result = tel("replay", SAMPLE / "trial_002", *arguments)
    assert result.exit_code == 2
    assert said in result.stderr


def test_a_bag_that_has_changed_is_not_played(make_run: MakeRun) -> None:
    bag = make_run([Trial()]) / "trial_001"
    sums = bag / "SHA256SUMS"
    sums.write_text("0" * 64 + sums.read_text(encoding="utf-8")[64:], encoding="utf-8")
    result = tel("replay", bag)
    assert (result.exit_code, "has changed since it was recorded" in result.stderr) == (2, True)
