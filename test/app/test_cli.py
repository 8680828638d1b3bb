"""What a person reads when something about the input is wrong: one line, exit code 2, nothing started."""

from __future__ import annotations

import io
import math
import signal
from pathlib import Path

import click
import pytest
from click.testing import CliRunner
from rich.console import Console
from tel_interfaces.action import Practice
from tel_interfaces.msg import TrialResult

from tel_ros.app import practice_command
from tel_ros.app.cli import main
from tel_ros.app.command_group import CommandGroup
from tel_ros.app.errors import EXIT_BAD_INPUT, EXIT_GRAPH_FAILED, EXIT_INTERRUPTED, GraphError, Interruption
from tel_ros.core.errors import TelError, TrainingError

PAPER = Path(__file__).parents[2] / "config" / "paper.yaml"


def run(*arguments: str) -> tuple[int, str, str]:
    result = CliRunner().invoke(main, list(arguments))
    return result.exit_code, result.stdout, result.stderr


def waypoints(tmp_path: Path, text: str) -> str:
    file = tmp_path / "waypoints.csv"
    file.write_text(text)
    return f"path.file={file}"


@pytest.mark.parametrize(
    ("override", "parts"),
    [
        ("control.coridor_rad=0.5", ["control.coridor_rad", "0.5", "known key", "path_tolerance_rad"]),
        ("control.path_tolerance_rad=-0.5", ["control.path_tolerance_rad", "-0.5", "finite number above 0"]),
        ("control.path_tolerance_rad=57 deg", ["control.path_tolerance_rad", "57 deg", "a finite number"]),
        ("practice.first_duration_s=3", ["practice.first_duration_s", "3.0", "goal_duration_s = 4.5"]),
        ("arm.urdf=nowhere.urdf", ["nowhere.urdf", "no such file", "arm.urdf"]),
        ("arm.joints=[shoulder, wrist]", ["arm.joints", "wrist", "shoulder, elbow"]),
        ("practice.goal_duration_s=0.5", ["practice.goal_duration_s", "0.5", "at least", "elbow", "rad/s"]),
        ("learning.name=lms_tre", ["learning.name", "lms_tre", "rigid_body+lms_tree", "tel_ros.learners"]),
        ("path.name=spiral", ["path.name", "spiral", "planar_loops"]),
        (
            "sim.command_delay_s=0.003",
            ["sim.command_delay_s", "0.003", "multiple of the control period 0.002 s"],
        ),
        ("practice.strategy", ["practice.strategy", "an assignment"]),
        ("practice.strategy=adaptive", ["practice.strategy", "adaptive", "adaptive_extension"]),
        ("practice.durations_s=[9, 3]", ["practice.durations_s", "3.0", "at least goal_duration_s = 4.5 s"]),
        ("practice.tolerance_rad=0.3", ["practice.step_tolerance_rad", "0.02", "tolerance_rad = 0.3"]),
        ("practice.vary=[shape]", ["path.known"]),
        ("practice.vary=[speed, tempo]", ["practice.vary", "tempo", "amplitude"]),
        ("practice.vary=[speed, speed]", ["practice.vary", "speed"]),
    ],
)
def test_wrong_values_are_named_with_what_was_expected(
    tmp_path: Path, override: str, parts: list[str]
) -> None:
    code, out, err = run("practice", str(PAPER), "--set", override, "--out", str(tmp_path / "run"))
    assert code == 2
    assert out == ""
    assert len(err.strip().splitlines()) == 1
    for part in parts:
        assert part in err
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("shoulder,elbow\n0.1,0.2\nnan,0.4\n", ["line 3", "shoulder", "nan", "a finite number in rad"]),
        ("shoulder,elbow\n0.1,0.2\n0.3\n", ["line 3 has 1 value", "expected 2"]),
        ("shoulder,wrist\n0.1,0.2\n", ["line 1", "wrist", "shoulder, elbow"]),
    ],
)
def test_malformed_waypoints_are_named_with_file_and_line(
    tmp_path: Path, text: str, parts: list[str]
) -> None:
    code, out, err = run(
        "practice", str(PAPER), "--set", waypoints(tmp_path, text), "--out", str(tmp_path / "run")
    )
    assert (code, out) == (2, "")
    assert str(tmp_path / "waypoints.csv") in err
    for part in parts:
        assert part in err


def test_a_missing_configuration_is_named(tmp_path: Path) -> None:
    code, _, err = run("practice", str(tmp_path / "mine.yaml"))
    assert code == 2
    assert f"{tmp_path / 'mine.yaml'}: there is no such file; expected a YAML file" in err


def test_an_urdf_that_is_none_is_named(tmp_path: Path) -> None:
    (tmp_path / "arm.urdf").write_text("<robot")
    code, _, err = run("practice", str(PAPER), "--set", f"arm.urdf={tmp_path / 'arm.urdf'}")
    assert code == 2
    assert f"{tmp_path / 'arm.urdf'}: not a readable URDF" in err


def test_a_folder_that_exists_is_refused_and_left_alone(tmp_path: Path) -> None:
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "precious").write_text("data")
    code, out, err = run("practice", str(PAPER), "--out", str(tmp_path / "run"))
    assert (code, out) == (2, "")
    assert f"{tmp_path / 'run'}: exists already; expected a folder that is new (option --out)" in err
    assert (tmp_path / "run" / "precious").read_text() == "data"


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (TrainingError("too few samples"), EXIT_BAD_INPUT),
        (GraphError("no joint states"), EXIT_GRAPH_FAILED),
        (GraphError("a node refused its value", EXIT_BAD_INPUT), EXIT_BAD_INPUT),
    ],
)
def test_the_exit_code_tells_wrong_input_from_a_graph_that_failed(error: TelError, code: int) -> None:
    def fail() -> None:
        raise error

    group = CommandGroup("tel", commands={"fail": click.Command("fail", callback=fail)})
    result = CliRunner().invoke(group, ["fail"])
    assert (result.exit_code, result.stderr) == (code, f"tel: {error}\n")


def test_ctrl_c_of_which_a_library_makes_another_error_is_an_interruption(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def fail() -> None:
        raise RuntimeError("Unable to convert call argument '0' to Python object")

    monkeypatch.setattr(signal, "signal", lambda *_: None)
    group = CommandGroup("tel", commands={"fail": click.Command("fail", callback=fail)})
    for asked, code in ((False, EXIT_GRAPH_FAILED), (True, EXIT_INTERRUPTED)):
        monkeypatch.setattr(Interruption, "asked", asked)
        assert CliRunner().invoke(group, ["fail"]).exit_code == code


def test_a_warning_is_one_line_without_code() -> None:
    code, _, err = run("practice", str(PAPER), "--set", "control.corridor_rad=-1")
    assert code == 2
    told = "control.corridor_rad is called control.path_tolerance_rad now"
    assert err.splitlines()[0] == f"warning: --set control.corridor_rad=-1: {told}"
    assert len(err.splitlines()) == 2


def test_help_names_the_commands_and_the_exit_codes() -> None:
    code, out, _ = run("--help")
    assert code == 0
    for part in ("practice", "report", "Exit codes"):
        assert part in out


def test_a_warning_about_learning_is_said_at_the_end(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    numbers = (
        "alpha",
        "duration_s",
        "rms_error_rad",
        "max_error_rad",
        "training_rms_before_rad",
        "training_rms_after_rad",
    )
    trial = {**dict.fromkeys(numbers, 0.5), "outcome": "completed", "message": "", "timing": None}
    warnings = ["", "learning lock-up: [early]", "learning lock-up: [late]", ""]
    trials = [{**trial, "index": k, "warning": text} for k, text in enumerate(warnings, start=1)]
    practice_command._show({"trials": trials, "outcome": "stopped", "message": "no way on"}, tmp_path, False)
    shown = capsys.readouterr().out
    assert "trial 3: learning lock-up: [late]" in shown
    assert "early" not in shown


def test_an_aborted_trial_is_told_with_its_reason_and_without_figures_that_nobody_measured() -> None:
    nan = math.nan
    trial = TrialResult(
        outcome=TrialResult.ABORTED, message="elbow is off", rms_error_rad=nan, max_error_rad=nan
    )
    feedback = Practice.Feedback(trial=2, reason="a larger step", last=[trial], training_rms_rad=[nan, nan])
    console = Console(file=io.StringIO())
    with practice_command.ProgressView(console) as view:
        view.update(feedback)
    line = console.file.getvalue()
    assert "aborted: elbow is off" in line
    assert "nan" not in line
