"""Learning torque from somebody else's file, and asking for it: what a person types and reads."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result
from made_up_recording import JOINTS, made_up, motion_at, torque_nm

import sim_bridge
from tel_ros.app.cli import main
from tel_ros.app.train import train
from tel_ros.core.learning.joint_recording import JointRecording
from tel_ros.recording.config_file import load_config
from tel_ros.recording.network_file import load_network, new_network, save_network

ROOT = Path(__file__).parents[2]
PLANAR_ARM = Path(sim_bridge.__file__).parent / "urdf" / "planar_arm.urdf"


def write(file: Path, recording: JointRecording) -> Path:
    names = ["time_s", *(f"q_{j}" for j in recording.joints), *(f"tau_{j}" for j in recording.joints)]
    values = np.column_stack([recording.time_s, recording.position_rad, recording.effort_nm])
    np.savetxt(file, values, delimiter=",", header=",".join(names), comments="")
    return file


def run_import(*arguments: object) -> Result:
    return CliRunner().invoke(main, ["train", "--import", *(str(argument) for argument in arguments)])


def run_predict(*arguments: object) -> Result:
    return CliRunner().invoke(main, ["predict", *map(str, arguments)])


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Half a minute of two joints at 50 Hz, as CSV."""
    return write(tmp_path_factory.mktemp("import") / "recording.csv", made_up(30.0, 50.0).recording)


@pytest.fixture(scope="module")
def rigid(recording: Path) -> tuple[Path, dict]:
    """A network of rigid links that has learned it, and what was printed about it."""
    pytest.importorskip("pinocchio")
    out = recording.parent / "rigid.npz"
    done = run_import(recording, "--urdf", PLANAR_ARM, "--out", out, "--json")
    assert done.exit_code == 0, done.output
    assert done.stderr == ""
    return out, json.loads(done.stdout)


def movement(file: Path, speed: float) -> Path:
    time_s = np.arange(300) / 100.0
    columns = [time_s[:, None], motion_at(time_s, speed)]
    names = ["time_s", *(f"{kind}_{joint}" for kind in ("q", "dq", "ddq") for joint in JOINTS)]
    np.savetxt(file, np.hstack(columns), delimiter=",", header=",".join(names), comments="")
    return file


def test_rigid_links_are_learned_to_a_hundredth(rigid: tuple[Path, dict]) -> None:
    out, report = rigid
    assert report["held_out"]["mean_nmse"] < 0.01
    assert [joint["joint"] for joint in report["joints"]] == list(JOINTS)
    assert report["warnings"] == []
    assert load_network(out).context.predicts == "torque"
    assert report["recordings"][0]["rate_hz"] == pytest.approx(50.0, rel=0.05)


def test_torques_of_a_movement_are_predicted_with_their_uncertainty(
    rigid: tuple[Path, dict], tmp_path: Path
) -> None:
    file = movement(tmp_path / "movement.csv", 0.9)
    done = run_predict(rigid[0], file, "--out", tmp_path / "torques.csv")
    assert done.exit_code == 0, done.output
    assert "slow recording" not in done.stderr  # a point or two may lie outside of the range of positions
    header, *_ = (tmp_path / "torques.csv").read_text().splitlines()
    assert header == "time_s,tau_shoulder,tau_elbow,std_shoulder,std_elbow"
    values = np.loadtxt(tmp_path / "torques.csv", delimiter=",", skiprows=1)
    error = values[:, 1:3] - torque_nm(motion_at(values[:, 0], 0.9))
    assert np.sqrt(np.mean(error**2)) < 0.05 * values[:, 1:3].std()
    assert np.mean(np.abs(error) < 3.0 * values[:, 3:]) > 0.95


def test_a_faster_movement_comes_with_a_warning(rigid: tuple[Path, dict], tmp_path: Path) -> None:
    done = run_predict(rigid[0], movement(tmp_path / "fast.csv", 3.0), "--json")
    assert done.exit_code == 0
    assert "A slow recording cannot teach a fast movement" in done.stderr
    assert "acceleration" in done.stderr
    result = json.loads(done.stdout)
    assert result["extrapolated_share"] > 0.8
    assert result["predicts"] == "torque"
    assert len(result["rows"]) == 300


def test_a_tree_needs_no_urdf_and_the_table_is_shown(recording: Path, tmp_path: Path) -> None:
    done = run_import(
        recording,
        "--learner",
        "lms_tree",
        "--max-subtrees",
        0,
        "--rate-hz",
        25,
        "--out",
        tmp_path / "tree.npz",
    )
    assert done.exit_code == 0, done.output
    for part in ("shoulder", "elbow", "held out  mean nMSE", "predicts torque"):
        assert part in done.stdout


def test_a_network_of_practice_gives_equilibrium_points_as_well(tmp_path: Path) -> None:
    config = load_config(ROOT / "config" / "planar_arm.yaml", [])
    save_network(new_network(config), tmp_path / "practice.npz")
    file = movement(tmp_path / "movement.csv", 0.5)
    done = run_predict(tmp_path / "practice.npz", file, "--json")
    assert done.exit_code == 0, done.output
    result = json.loads(done.stdout)
    rows = np.array([[np.nan if v is None else v for v in row] for row in result["rows"]])
    assert result["columns"][-2:] == ["u_shoulder", "u_elbow"]
    assert result["predicts"] == "equilibrium"
    inputs = motion_at(rows[:, 0], 0.5)
    # Untrained: u = q, so that the springs only damp; and nothing is known.
    np.testing.assert_allclose(rows[:, 5:], inputs[:, :2])
    np.testing.assert_allclose(rows[:, 1:3], -np.array(config.arm.damping_nms_per_rad) * inputs[:, 2:4])
    assert np.isnan(rows[:, 3:5]).all()
    assert result["extrapolated_share"] == 1.0


def test_waypoints_are_run_along(rigid: tuple[Path, dict], tmp_path: Path) -> None:
    (tmp_path / "w.csv").write_text("shoulder,elbow\n0.3,1.0\n0.8,1.4\n")
    done = run_predict(rigid[0], tmp_path / "w.csv", "--duration-s", 4, "--rate-hz", 10)
    assert done.exit_code == 0
    assert len(done.stdout.splitlines()) == 42


@pytest.mark.parametrize(
    ("options", "parts"),
    [
        ([], ["--urdf is ''", "rigid_body needs"]),
        (["--urdf", "nowhere.urdf"], ["nowhere.urdf", "no such file"]),
        (["--learner", "rigid_bod"], ["learning.name is 'rigid_bod'", "lms_tree"]),
        (["--learner", "lms_tree", "--joints", "wrist"], ["no column tau_wrist"]),
        (["--learner", "lms_tree", "--joints", "elbow,elbow"], ["--joints", "each joint once"]),
        (["--learner", "lms_tree", "--rate-hz", "0"], ["--rate-hz is 0.0"]),
        (["--learner", "lms_tree", "--cutoff-hz", "nan"], ["--cutoff-hz is nan"]),
        (["--urdf", str(PLANAR_ARM), "--joints", "elbow"], ["also shoulder, which moved by"]),
    ],
)
def test_wrong_input_is_told_in_one_line_and_nothing_is_written(
    recording: Path, tmp_path: Path, options: list[str], parts: list[str]
) -> None:
    done = run_import(recording, "--out", tmp_path / "net.npz", *options)
    assert (done.exit_code, done.stdout) == (2, "")
    assert len(done.stderr.strip().splitlines()) == 1
    for part in parts:
        assert part in done.stderr
    assert not (tmp_path / "net.npz").exists()


def test_a_short_recording_is_refused(tmp_path: Path) -> None:
    file = write(tmp_path / "short.csv", made_up(2.0, 100.0).recording)
    done = run_import(file, "--learner", "lms_tree", "--out", tmp_path / "net.npz")
    assert done.exit_code == 2
    assert "Record longer" in done.stderr


def test_no_network_is_overwritten(rigid: tuple[Path, dict], recording: Path) -> None:
    done = run_import(recording, "--learner", "lms_tree", "--out", rigid[0])
    assert done.exit_code == 2
    assert "exists already" in done.stderr


def test_torque_that_does_not_belong_to_the_motion_is_warned_about(tmp_path: Path) -> None:
    made = made_up(15.0, 50.0).recording
    shuffled = np.random.default_rng(1).permutation(made.effort_nm)
    mixed = JointRecording(made.source, made.joints, made.time_s, made.position_rad, shuffled)
    options = ("--learner", "lms_tree", "--max-subtrees", 0, "--out", tmp_path / "n.npz")
    done = run_import(write(tmp_path / "mixed.csv", mixed), *options)
    assert done.exit_code == 0
    assert "predicted badly" in done.stderr


def renamed(file: Path) -> Path:
    file.write_text(file.read_text().replace("_shoulder", "_left_shoulder").replace("_elbow", "_left_elbow"))
    return file


def test_joints_are_renamed_in_recordings_and_in_movements(rigid: tuple[Path, dict], tmp_path: Path) -> None:
    file = movement(tmp_path / "movement.csv", 0.9)
    renamed(file)
    done = run_predict(rigid[0], file)
    assert done.exit_code == 2
    assert "has no column q_shoulder, q_elbow" in done.stderr
    assert "(--rename left_=?)" in done.stderr
    assert run_predict(rigid[0], file, "--rename", "left_=").exit_code == 0
    recording = write(tmp_path / "recording.csv", made_up(30.0, 50.0).recording)
    recording.write_text(
        recording.read_text().replace("_shoulder", "_left_shoulder").replace("_elbow", "_left_elbow")
    )
    options = (recording, "--urdf", PLANAR_ARM, "--out", tmp_path / "net.npz")
    assert "(--rename left_=?)" in run_import(*options).stderr
    done = run_import(*options, "--rename", "left_=", "--json")
    assert [joint["joint"] for joint in json.loads(done.stdout)["joints"]] == list(JOINTS)


@pytest.mark.parametrize("arguments", [["--import", "--set", "seed=2"], ["--import", "--force"]])
def test_settings_of_a_run_do_not_go_with_an_import(tmp_path: Path, arguments: list[str]) -> None:
    result = CliRunner().invoke(train, [*arguments, str(tmp_path), "--out", str(tmp_path / "net.npz")])
    assert result.exit_code == 2
    assert f"{arguments[1]} cannot be used with --import" in result.output


def test_settings_of_an_import_do_not_go_without_it(tmp_path: Path) -> None:
    arguments = [str(tmp_path), "--out", str(tmp_path / "net.npz"), "--urdf", "arm.urdf"]
    result = CliRunner().invoke(train, arguments)
    assert result.exit_code == 2
    assert "--urdf can only be used with --import" in result.output
