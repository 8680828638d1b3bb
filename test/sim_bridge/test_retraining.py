"""Learning again from bags: bit by bit what the run has learned, or a reason why not."""

from __future__ import annotations

import base64
import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml
from click.testing import CliRunner
from recorded_run import record_run

from tel_ros.app.cli import main
from tel_ros.core.config import Config
from tel_ros.core.errors import BagError, ConfigError, InputFileError
from tel_ros.recording.config_file import load_config
from tel_ros.recording.network_file import load_network
from tel_ros.recording.retraining import train
from tel_ros.recording.run_folder import NETWORK_FILE, network_after, trial_bag, trial_bags

CONFIG_FOLDER = Path(__file__).parents[2] / "config"
SHORT = (
    *("practice.first_duration_s=4.0", "practice.goal_duration_s=3.0", "control.approach_speed_rad_s=1.5"),
    *("learning.gaussians_per_input=5", "control.settle_time_s=0.2"),
    *("control.rate_hz=200", "sim.physics_rate_hz=1000"),
)
RUNS = {
    "lms": ("paper.yaml", "practice.trials=2"),
    "lms in sqlite3": ("paper.yaml", "practice.trials=2", "recording.storage=sqlite3"),
    # Learns next to nothing, so that trial 2 is aborted; learns from it, and goes back to what was before.
    "adaptive": (
        "planar_arm.yaml",
        *("practice.trials=3", "practice.first_duration_s=9.0", "practice.step_tolerance_rad=0.9"),
        *("control.path_tolerance_rad=0.285", "practice.on_abort=continue"),
        *("learning.weights=lms", "learning.rate=0.003", "learning.passes=1"),
    ),
}


def config(name: str) -> Config:
    file, *overrides = RUNS[name]
    return load_config(CONFIG_FOLDER / file, [*SHORT, *overrides])


@pytest.fixture(scope="module", params=list(RUNS))
def run(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run. Tests only look at it: making it takes seconds."""
    folder = tmp_path_factory.mktemp("runs") / request.param.replace(" ", "_")
    record_run(folder, config(request.param))
    return folder


@pytest.fixture(scope="module")
def lms_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run with one trial. Tests only look at it."""
    folder = tmp_path_factory.mktemp("runs") / "short"
    record_run(folder, load_config(CONFIG_FOLDER / "paper.yaml", [*SHORT, "practice.trials=1"]))
    return folder


@pytest.fixture
def edited(lms_run: Path, tmp_path: Path) -> Callable[..., Path]:
    """Copy the bag of a trial with other metadata: ``edited(lambda data: ...)``."""

    def edit(change: Callable[[dict[str, str]], None]) -> Path:
        bag = tmp_path / "other" / "trial_001"
        shutil.copytree(trial_bag(lms_run, 1), bag)
        file = bag / "metadata.yaml"
        information = yaml.safe_load(file.read_text(encoding="utf-8"))
        change(information["rosbag2_bagfile_information"]["custom_data"])
        file.write_text(yaml.safe_dump(information, allow_unicode=True), encoding="utf-8")
        return bag

    return edit


def with_arm(**values: object) -> Callable[[dict[str, str]], None]:
    def change(data: dict[str, str]) -> None:
        stored = yaml.safe_load(data["config"])
        stored["arm"] |= values
        data["config"] = yaml.safe_dump(stored)

    return change


def test_a_runs_folder_gives_the_network_that_the_run_left(run: Path, tmp_path: Path) -> None:
    found = train([run], tmp_path / "network.npz")
    assert found["as_recorded"]
    assert (tmp_path / "network.npz").read_bytes() == (run / NETWORK_FILE).read_bytes()
    summary = json.loads((run / "summary.json").read_text())
    for row, lesson in zip(summary["trials"], found["bags"], strict=True):
        for key in ("index", "outcome", "training_rms_before_rad", "training_rms_after_rad", "grown"):
            assert lesson[key] == row[key], key
        assert lesson["rms_error_rad"] == pytest.approx(row["rms_error_rad"], rel=1e-9, nan_ok=True)


@pytest.mark.parametrize("run", ["adaptive"], indirect=True)
def test_the_adaptive_run_goes_back_to_an_earlier_network(run: Path) -> None:
    """What makes the test above worth something."""
    rows = json.loads((run / "summary.json").read_text())["trials"]
    assert (rows[1]["outcome"], rows[2]["went_back_to"]) == ("aborted", 1)
    assert network_after(run, 2).read_bytes() != network_after(run, 1).read_bytes()


def test_bags_alone_are_enough_wherever_they_lie(run: Path, tmp_path: Path) -> None:
    bags = [Path(shutil.copytree(bag, tmp_path / "elsewhere" / bag.name)) for bag in trial_bags(run)]
    train(bags, tmp_path / "network.npz")
    assert (tmp_path / "network.npz").read_bytes() == (run / NETWORK_FILE).read_bytes()


def test_waypoints_and_an_earlier_network_are_in_the_bags_as_well(lms_run: Path, tmp_path: Path) -> None:
    waypoints = tmp_path / "eight.csv"
    waypoints.write_text("shoulder,elbow\n0.1,0.5\n0.4,1.0\n0.2,0.7\n")
    overrides = ["practice.trials=1", f"path.file={waypoints}"]
    overrides += [f"learning.start_from={lms_run / NETWORK_FILE}"]
    record_run(tmp_path / "run", load_config(CONFIG_FOLDER / "paper.yaml", [*SHORT, *overrides]))
    (bag,) = trial_bags(tmp_path / "run")
    alone = Path(shutil.copytree(bag, tmp_path / "alone" / bag.name))
    expected = (tmp_path / "run" / NETWORK_FILE).read_bytes()
    shutil.rmtree(tmp_path / "run")
    waypoints.unlink()
    found = train([alone], tmp_path / "network.npz")
    assert found["as_recorded"]
    assert (tmp_path / "network.npz").read_bytes() == expected
    assert load_network(tmp_path / "network.npz").trials_learned == 2


def test_some_of_the_trials_give_another_network_and_it_is_said_from_where_on(
    run: Path, tmp_path: Path
) -> None:
    second = trial_bags(run)[1]
    found = train([second], tmp_path / "network.npz")
    assert not found["as_recorded"]
    assert found["differs_at"] == str(second)


def test_other_settings_of_the_learner_give_another_network(lms_run: Path, tmp_path: Path) -> None:
    found = train([lms_run], tmp_path / "network.npz", ["learning.weights=least_squares", "seed=3"])
    network = load_network(tmp_path / "network.npz")
    assert (network.context.learning.weights, network.context.seed) == ("least_squares", 3)
    assert not found["as_recorded"]


def test_settings_of_what_was_recorded_are_refused(lms_run: Path, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"control\.rate_hz=100.*expected a key of learning, seed"):
        train([lms_run], tmp_path / "network.npz", ["control.rate_hz=100"])


@pytest.mark.parametrize(
    ("values", "parts"),
    [
        ({"name": "other_arm"}, ["arm.name is 'other_arm'", "expected 'planar_arm'"]),
        ({"joints": ["elbow", "shoulder"]}, ["arm.joints is ('elbow', 'shoulder')", "('shoulder', 'elbow')"]),
        ({"stiffness_nm_per_rad": [15.0, 20.0]}, ["stiffness_nm_per_rad is (15.0, 20.0)", "(15.0, 15.0)"]),
        ({"damping_nms_per_rad": [1.5, 2.0]}, ["damping_nms_per_rad is (1.5, 2.0)", "(1.5, 1.5)"]),
        ({"command_interface": "position"}, ["command_interface is 'position'", "'effort'"]),
    ],
    ids=lambda value: next(iter(value)) if isinstance(value, dict) else "",
)
def test_bags_of_another_arm_are_refused_with_the_difference(
    lms_run: Path,
    edited: Callable[..., Path],
    tmp_path: Path,
    values: dict[str, object],
    parts: list[str],
) -> None:
    first, other = trial_bag(lms_run, 1), edited(with_arm(**values))
    with pytest.raises(BagError) as caught:
        train([first, other], tmp_path / "network.npz")
    for part in [str(other), *parts, f"as in {first}"]:
        assert part in str(caught.value)
    assert not (tmp_path / "network.npz").exists()


def test_bags_of_an_arm_with_another_urdf_are_refused(
    lms_run: Path, edited: Callable[..., Path], tmp_path: Path
) -> None:
    def heavier(data: dict[str, str]) -> None:
        content = base64.b64decode(data["file.arm.urdf"].removeprefix("base64:"))
        # Bags of earlier versions hold the text as it is.
        data["file.arm.urdf"] = content.decode().replace("<mass", "<!-- --><mass", 1)

    with pytest.raises(BagError, match=r"arm\.urdf is 'a text with the SHA-256 \w+'; expected 'a text"):
        train([trial_bag(lms_run, 1), edited(heavier)], tmp_path / "network.npz")


def test_a_recovered_bag_is_refused(edited: Callable[..., Path], tmp_path: Path) -> None:
    bag = edited(lambda data: data.update(recovered="1200 of about 1300 ticks"))
    with pytest.raises(BagError, match="was recovered after a crash"):
        train([bag], tmp_path / "network.npz")


def test_a_bag_that_was_never_closed_is_refused(lms_run: Path, tmp_path: Path) -> None:
    bag = Path(shutil.copytree(trial_bag(lms_run, 1), tmp_path / "trial_001"))
    (bag / "metadata.yaml").unlink()
    with pytest.raises(BagError, match="was never closed"):
        train([bag], tmp_path / "network.npz")


def test_a_damaged_bag_is_refused(lms_run: Path, tmp_path: Path) -> None:
    bag = Path(shutil.copytree(trial_bag(lms_run, 1), tmp_path / "trial_001"))
    (data,) = [file for file in bag.iterdir() if file.name.startswith("trial_001.")]
    content = bytearray(data.read_bytes())
    content[len(content) // 2] ^= 1
    data.write_bytes(content)
    with pytest.raises(BagError, match="has changed since it was recorded"):
        train([bag], tmp_path / "network.npz")


def test_a_bag_that_is_named_twice_is_refused(lms_run: Path, tmp_path: Path) -> None:
    with pytest.raises(BagError, match="is named twice"):
        train([lms_run, trial_bag(lms_run, 1)], tmp_path / "network.npz")


def test_an_existing_file_is_kept_unless_told_otherwise(lms_run: Path, tmp_path: Path) -> None:
    out = tmp_path / "network.npz"
    out.write_bytes(b"of yesterday")
    with pytest.raises(InputFileError, match="exists already"):
        train([lms_run], out)
    assert out.read_bytes() == b"of yesterday"
    train([lms_run], out, force=True)
    np.testing.assert_array_equal(
        load_network(out).subtrees, load_network(network_after(lms_run, 1)).subtrees
    )


def test_the_command_prints_the_errors_of_each_bag(lms_run: Path, tmp_path: Path) -> None:
    arguments = ["train", str(lms_run), "--out", str(tmp_path / "network.npz")]
    told = CliRunner().invoke(main, [*arguments, "--json"])
    assert told.exit_code == 0, told.stderr
    (row,) = json.loads(told.stdout)["bags"]
    shown = CliRunner().invoke(main, [*arguments, "--force"])
    before, after = row["training_rms_before_rad"], row["training_rms_after_rad"]
    assert f"{before:.4f} → {after:.4f}" in shown.stdout
    refused = CliRunner().invoke(main, arguments)
    assert (refused.exit_code, refused.stdout) == (2, "")
    assert "exists already" in refused.stderr
