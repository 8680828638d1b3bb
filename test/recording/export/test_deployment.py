"""``tel deploy``: the practised movement through the law of ros2_control's joint_trajectory_controller."""

from __future__ import annotations

import ast
import json
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from click.testing import CliRunner, Result
from rosbags.highlevel import AnyReader
from scipy.interpolate import BPoly

from sim_bridge.arm import SimulatedArm
from sim_bridge.splines import points_of
from sim_bridge.trajectory_control import Gains, Tolerances, TrajectoryController
from tel_ros.app.cli import main
from tel_ros.core.control.trajectory_points import thinned
from tel_ros.core.types import NS_PER_S
from tel_ros.recording.export import deployment
from tel_ros.recording.export.deployment import LOST_SHARE, Deployment, deploy, practised
from tel_ros.recording.resumption import resumed_config
from tel_ros.recording.trial_bag import read_trial

SAMPLE_RUN = Path(__file__).parents[3] / "bags" / "sample_run"
RATE_HZ = 1000.0


def told(*arguments: object) -> Result:
    return CliRunner().invoke(main, ["deploy", *map(str, arguments)])


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """The sample run, whose second and last trial has 102 mrad RMS, with a tolerance that this keeps."""
    folder = shutil.copytree(SAMPLE_RUN, tmp_path / "run")
    config = yaml.safe_load((folder / "run.yaml").read_text())
    config["practice"] |= {"tolerance_rad": 0.15, "step_tolerance_rad": 0.15}
    (folder / "run.yaml").write_text(yaml.safe_dump(config))
    return folder


def executed(folder: Path, run: Path, rate_hz: float, start_rad: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return times [s] and positions of the simulated arm under the controller, from the deployed files."""
    as_json = json.dumps(yaml.safe_load((folder / "trajectory.yaml").read_text()))
    trajectory = json.loads(as_json, object_hook=lambda values: SimpleNamespace(**values))
    gains = yaml.safe_load((folder / "controllers.yaml").read_text())
    gains = gains["joint_trajectory_controller"]["ros__parameters"]["gains"].values()
    config = resumed_config(run)
    law = TrajectoryController(
        config.arm.joints,
        rate_hz,
        Gains(*(np.array([joint[key] for joint in gains]) for key in ("p", "i", "d", "ff_velocity_scale"))),
    )
    sim = replace(config.sim, initial_position_rad=tuple(start_rad))
    n_joints, times, seen = len(start_rad), [], []
    with SimulatedArm(config.arm, sim, rate_hz=rate_hz, seed=5) as arm:
        points = points_of(trajectory, config.arm.joints, arm.time_ns)
        law.follow(points, Tolerances.of((0.0,) * n_joints, (0.0,) * n_joints, 0.0, 0.0))
        while law.has_goal:
            reading = arm.reading()
            law.update(*reading[:3])
            arm.step(law.effort_nm.tolist())
            times.append(reading.time_ns / NS_PER_S)
            seen.append(reading.position_rad)
    return np.array(times), np.array(seen)


@pytest.mark.parametrize(("rate_hz", "apart_mrad"), [(500.0, 0.1), (1000.0, 1.0)])
def test_the_stock_controller_moves_the_arm_as_practice_did(
    rate_hz: float, apart_mrad: float, run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(deployment, "LOST_SHARE", 0.001)  # of a tolerance that is thirty times the usual
    result = told(run, "--out", tmp_path / "out", "--rate-hz", rate_hz, "--json")
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["trial"]["index"] == 2
    trial = read_trial(run / "trial_002")
    seen_rad = trial.position_rad[trial.run]
    time_s, position_rad = executed(tmp_path / "out", run, rate_hz, seen_rad[0])
    practised_rad = np.column_stack([np.interp(time_s, trial.time_s[trial.run], q) for q in seen_rad.T])
    assert 1e3 * np.sqrt(np.mean((position_rad - practised_rad) ** 2)) < apart_mrad
    assert 1e3 * trial.report.rms_error_rad > 100.0, "the error is executed as well"


def test_positions_between_points_stay_where_they_were_practised(run: Path) -> None:
    movement, trial = practised(run, RATE_HZ), read_trial(run / "trial_002")
    points = movement.points
    states = [points.position_rad, points.velocity_rad_s, points.acceleration_rad_s2]
    spline = BPoly.from_derivatives(points.time_ns / NS_PER_S, np.stack(states, axis=1))
    desired_rad = trial.desired[trial.run, :2]
    assert len(points.time_ns) < 0.2 * len(desired_rad)
    off_rad = spline(trial.time_s[trial.run]) - desired_rad
    assert np.max(np.abs(off_rad)) < 0.01 * LOST_SHARE * movement.tolerance_rad


def test_the_bag_holds_the_same_trajectory_as_the_file(run: Path, tmp_path: Path) -> None:
    assert told(run, "--out", tmp_path / "out").exit_code == 0
    with AnyReader([tmp_path / "out" / "bag"]) as reader:
        ((connection, _, raw),) = reader.messages()
        message = reader.deserialize(raw, connection.msgtype)
    assert connection.topic == "/joint_trajectory_controller/joint_trajectory"
    in_file = yaml.safe_load((tmp_path / "out" / "trajectory.yaml").read_text())
    assert message.joint_names == in_file["joint_names"] == ["shoulder", "elbow"]
    for point, told_point in zip(message.points, in_file["points"], strict=True):
        assert point.effort.tolist() == told_point["effort"]
        assert point.positions.tolist() == told_point["positions"]
    assert not any(message.points[-1].velocities), "the controller refuses to end in motion"


def test_readme_and_client_fit_the_trajectory(run: Path, tmp_path: Path) -> None:
    assert told(run, "--out", tmp_path / "out").exit_code == 0
    text = (tmp_path / "out" / "README.md").read_text()
    assert "101.76 mrad RMS (tolerance 150)" in text
    assert "at\n   1000 Hz" in text
    assert "with a payload of 0 kg (simulated)" in text and "of its limit (shoulder)" in text
    points = yaml.safe_load((tmp_path / "out" / "trajectory.yaml").read_text())["points"]
    sag_mrad = [1e3 * max(map(abs, points[end]["effort"])) / 15.0 for end in (0, -1)]  # K is 15 N·m/rad
    for mrad, where in zip(sag_mrad, ("start", "end"), strict=True):
        assert f"{mrad:.1f} mrad (shoulder) at the {where}" in text
    assert "ros2 action send_goal" in text and "$(cat trajectory.yaml)" in text
    assert "send_goal_async" in ast.unparse(ast.parse((tmp_path / "out" / "run_movement.py").read_text()))


def large(movement: Deployment) -> Deployment:
    n = 4000
    arrays = ("position_rad", "velocity_rad_s", "acceleration_rad_s2", "effort_nm")
    values = {name: np.full((n, 2), 1.0 / 3.0) for name in arrays}
    points = replace(movement.points, time_ns=np.arange(n, dtype=np.int64), **values)
    return replace(movement, points=points)


def test_a_trajectory_that_no_command_line_takes_is_run_by_its_client(run: Path, tmp_path: Path) -> None:
    deploy(large(practised(run, rate_hz=RATE_HZ)), tmp_path / "out")
    text = (tmp_path / "out" / "README.md").read_text()
    assert "send_goal" not in text and "python3 run_movement.py" in text


def test_only_so_many_points_are_left_out_as_the_tolerance_allows(run: Path) -> None:
    movement = practised(run, rate_hz=RATE_HZ)
    trial = read_trial(run / "trial_002")
    assert 2 < len(movement.points.time_ns) < trial.run.sum()
    values = np.sin(np.linspace(0.0, 6.0, 500))[:, None]
    time_ns = np.arange(500, dtype=np.int64)
    for lost in (1e-2, 1e-3):
        kept = thinned(time_ns, values, lost)
        line = np.interp(time_ns, time_ns[kept], values[kept, 0])
        assert kept[0] == 0 and kept[-1] == 499 and 0.3 * lost < np.max(np.abs(line - values[:, 0])) <= lost
    assert len(thinned(time_ns, np.random.default_rng(1).normal(size=(500, 1)), LOST_SHARE * 0.005)) == 500


def test_what_was_not_practised_is_refused_and_nothing_is_written(run: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"

    def refused(*arguments: object) -> str:
        result = told(*arguments, "--out", out)
        assert result.exit_code == 2 and not out.exists(), result.output
        return result.stderr

    assert "trial 2 (completed, 3 s): 101.76 mrad RMS; expected a completed one within" in refused(SAMPLE_RUN)
    assert "trial 1 (completed, 3.5 s): 302.27 mrad RMS" in refused(run, "--trial", 1)
    assert "has no trial 7; expected one of 2" in refused(run, "--trial", 7)
    for rate_hz in ("nan", "0", "inf"):
        assert f"--rate-hz is {float(rate_hz)}; expected 1 to 100,000" in refused(run, "--rate-hz", rate_hz)
    assert "is no practice run" in refused(tmp_path / "nowhere")
    summary = json.loads((run / "summary.json").read_text())
    (run / "summary.json").write_text(json.dumps({**summary, "trials": [{"index": 1}]}))
    assert "not readable: its trials do not have what a trial has" in refused(run)
    (run / "summary.json").write_text(json.dumps({**summary, "outcome": "running"}))
    assert "the run goes on, or was interrupted" in refused(run)
    (run / "summary.json").write_text(json.dumps(summary))
    config = yaml.safe_load((run / "run.yaml").read_text())
    config["arm"]["command_interface"] = "position"
    (run / "run.yaml").write_text(yaml.safe_dump(config))
    assert "arm.command_interface is 'position'; expected effort" in refused(run)


def test_of_several_movements_each_gets_a_folder_or_one_alone_is_written(run: Path, tmp_path: Path) -> None:
    config, summary = (
        yaml.safe_load((run / "run.yaml").read_text()),
        json.loads((run / "summary.json").read_text()),
    )
    config["path"] |= {"name": "", "file": "", "files": ["pick.csv", "place.csv"]}
    for row, path in zip(summary["trials"], ("pick", "place"), strict=True):
        row["path"] = path
    (run / "run.yaml").write_text(yaml.safe_dump(config))
    (run / "summary.json").write_text(json.dumps(summary))
    out = tmp_path / "out"
    result = told(run, "--out", out)
    assert result.exit_code == 2 and "trial 1 of pick (completed, 3.5 s): 302.27 mrad RMS" in result.stderr
    assert not out.exists(), "all of them or none"
    assert "--path is 'drop'; expected one of pick, place" in told(run, "--out", out, "--path", "drop").stderr
    assert told(run, "--out", tmp_path / "one", "--path", "place").exit_code == 0
    assert (tmp_path / "one" / "trajectory.yaml").is_file()

    config["practice"] |= {"tolerance_rad": 0.4, "step_tolerance_rad": 0.4}
    (run / "run.yaml").write_text(yaml.safe_dump(config))
    result = told(run, "--out", out, "--json")
    assert result.exit_code == 0, result.output
    assert [each["trial"]["path"] for each in json.loads(result.stdout)["movements"]] == ["pick", "place"]
    texts = [(out / name / "README.md").read_text() for name in ("pick", "place")]
    assert "movement of 3.500 s" in texts[0] and "movement of 3.000 s" in texts[1]


def test_a_damaged_bag_and_a_folder_that_is_there_are_refused(run: Path, tmp_path: Path) -> None:
    (tmp_path / "there").mkdir()
    assert "exists already" in told(run, "--out", tmp_path / "there").stderr
    data = next((run / "trial_002").glob("*.mcap"))
    data.write_bytes(data.read_bytes()[:-100])
    result = told(run, "--out", tmp_path / "out")
    assert result.exit_code == 2 and "trial_002" in result.stderr and not (tmp_path / "out").exists()
