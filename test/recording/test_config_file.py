"""Reading a practice run: values, options and the files that it names."""

from __future__ import annotations

import dataclasses
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

from tel_ros.core.config import Config, file_keys, file_values
from tel_ros.core.errors import ConfigError
from tel_ros.recording.config_file import (
    dump_config,
    flat_values,
    load_config,
    to_plain,
    with_values,
)
from tel_ros.recording.provenance import stored_files, unpacked_config
from tel_ros.recording.run_folder import create_run_folder
from tel_ros.recording.shared_files import config_folder

Edit = Callable[[str, str, str], Path]


def test_the_papers_protocol_is_the_default_and_says_what_the_paper_says() -> None:
    config = load_config(config_folder() / "paper.yaml")
    practice, arm, learning = config.practice, config.arm, config.learning
    assert (practice.strategy, practice.trials) == ("trajectory_extension", 15)
    assert (practice.first_duration_s, practice.goal_duration_s) == (11.5, 4.5)
    assert arm.stiffness_nm_per_rad == (15.0, 15.0)
    assert arm.damping_nms_per_rad == (1.5, 1.5)
    assert (learning.name, learning.training, learning.max_subtrees) == ("lms_tree", "actual", 15)


def test_values_come_from_the_run_the_arm_and_the_defaults(config: Config) -> None:
    assert config.control.path_tolerance_rad == 0.8
    assert config.practice.trials == 3
    assert config.arm.name == "two_link"
    assert config.control.rate_hz == 500.0


def test_the_limits_of_the_joints_come_from_the_urdf(config: Config) -> None:
    assert config.arm.position_min_rad == (-2.9, -2.9)
    assert config.arm.position_max_rad == (2.9, 2.9)
    assert config.arm.velocity_limit_rad_s == (15.0, 15.0)


def test_what_may_hold_a_joint_comes_from_its_dry_friction_where_that_is_known(config_folder: Path) -> None:
    run = config_folder / "run.yaml"
    much, little = "sim.coulomb_friction_nm=[2.0, 0.1]", "sim.coulomb_friction_nm=[0.5, 0.1]"
    assert load_config(run, [much]).safety.stiction_nm == (3.0, 1.0)
    assert load_config(run, [little]).safety.stiction_nm == ()
    assert load_config(run, [much, "run.arm=external"]).safety.stiction_nm == ()
    assert load_config(run, [much, "safety.stiction_nm=[4.0, 4.0]"]).safety.stiction_nm == (4.0, 4.0)


def test_limits_in_the_arm_description_take_the_place_of_the_urdfs(edit: Edit) -> None:
    file = edit("arms/two_link.yaml", "hand_link: hand\n", "hand_link: hand\nvelocity_limit_rad_s: [3, 4]\n")
    arm = load_config(file).arm
    assert arm.velocity_limit_rad_s == (3.0, 4.0)
    assert arm.position_max_rad == (2.9, 2.9)


def test_a_urdf_of_a_package_can_be_named_in_the_file_and_as_an_option(
    config_folder: Path, edit: Edit, monkeypatch: pytest.MonkeyPatch
) -> None:
    package = config_folder / "robots_to_configure"
    shutil.copytree(config_folder / "robots", package)
    (package / "__init__.py").touch()
    monkeypatch.syspath_prepend(config_folder)
    name, file = "package://robots_to_configure/planar_arm.urdf", str(package / "planar_arm.urdf")
    assert load_config(config_folder / "run.yaml", [f"arm.urdf={name}"]).arm.urdf == file
    assert load_config(edit("arms/two_link.yaml", "../robots/planar_arm.urdf", name)).arm.urdf == file


def test_files_are_found_relative_to_the_file_that_names_them(
    config_folder: Path, edit: Edit, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    file = edit("run.yaml", "name: planar_loops", "file: figures/eight.csv")
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    monkeypatch.chdir(elsewhere)
    config = load_config(file)
    assert Path(config.arm.urdf) == (config_folder / "robots" / "planar_arm.urdf").resolve()
    assert Path(config.path.file) == (config_folder / "figures" / "eight.csv").resolve()


def test_an_arm_can_be_described_in_the_run_itself(config_folder: Path, config: Config) -> None:
    raw = yaml.safe_load((config_folder / "run.yaml").read_text())
    raw["arm"] = yaml.safe_load((config_folder / "arms" / "two_link.yaml").read_text())
    raw["arm"]["urdf"] = "robots/planar_arm.urdf"  # relative to the run now
    (config_folder / "inline.yaml").write_text(yaml.safe_dump(raw))
    assert load_config(config_folder / "inline.yaml") == config


def test_a_configuration_that_is_written_and_read_again_is_the_same(config: Config, tmp_path: Path) -> None:
    config = dataclasses.replace(
        config,
        versions={"python": "3.11", "tel_ros": "0.1.0"},
        sim=dataclasses.replace(config.sim, initial_position_rad=(0.1, 1e-7)),
    )
    file = tmp_path / "again.yaml"
    file.write_text(dump_config(config), encoding="utf-8")
    assert load_config(file) == config


def test_plain_values_are_those_that_yaml_and_json_know(config: Config) -> None:
    assert yaml.safe_load(dump_config(config)) == to_plain(config)
    assert to_plain(config)["arm"]["joints"] == ["shoulder", "elbow"]


def test_flat_values_have_dotted_keys(config: Config) -> None:
    flat = flat_values(config)
    assert flat["control.path_tolerance_rad"] == 0.8
    assert flat["arm.joints"] == ["shoulder", "elbow"]
    assert flat["seed"] == 7
    assert not any(isinstance(value, dict) for value in flat.values())


@pytest.mark.parametrize(
    ("assignment", "key", "value"),
    [
        ("control.path_tolerance_rad=0.5", "control.path_tolerance_rad", 0.5),
        ("control.path_tolerance_rad = 2", "control.path_tolerance_rad", 2.0),
        ("practice.trials=4", "practice.trials", 4),
        ("sim.gui=true", "sim.gui", True),
        ("sim.clock=realtime", "sim.clock", "realtime"),
        ("seed=12", "seed", 12),
        ("arm.stiffness_nm_per_rad=[10, 12.5]", "arm.stiffness_nm_per_rad", [10.0, 12.5]),
        ("sim.coulomb_friction_nm=[0.1, 0.2]", "sim.coulomb_friction_nm", [0.1, 0.2]),
        ("sim.command_delay_s=2e-3", "sim.command_delay_s", 0.002),
    ],
)
def test_an_option_takes_the_place_of_a_value(
    config_folder: Path, assignment: str, key: str, value: Any
) -> None:
    assert flat_values(load_config(config_folder / "run.yaml", [assignment]))[key] == value


def test_of_two_options_for_a_key_the_last_one_counts(config_folder: Path) -> None:
    options = ["practice.trials=4", "practice.trials=6"]
    assert load_config(config_folder / "run.yaml", options).practice.trials == 6


def test_a_path_file_as_an_option_takes_the_place_of_the_path_by_name(
    config_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(config_folder)
    config = load_config(config_folder / "run.yaml", ["path.file=eight.csv"])
    assert (config.path.name, Path(config.path.file)) == ("", (config_folder / "eight.csv").resolve())


def test_a_path_name_as_an_option_takes_the_place_of_the_path_from_a_file(edit: Edit) -> None:
    file = edit("run.yaml", "name: planar_loops", "file: eight.csv")
    config = load_config(file, ["path.name=planar_loops"])
    assert (config.path.name, config.path.file) == ("planar_loops", "")


def test_of_a_path_name_and_a_path_file_as_options_the_last_one_counts(config_folder: Path) -> None:
    options = ["path.file=eight.csv", "path.name=planar_loops"]
    assert load_config(config_folder / "run.yaml", options).path.name == "planar_loops"
    assert load_config(config_folder / "run.yaml", options[::-1]).path.name == ""


def test_a_urdf_as_an_option_is_relative_to_where_the_user_is(
    config_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copy(config_folder / "robots" / "planar_arm.urdf", config_folder / "other.urdf")
    monkeypatch.chdir(config_folder)
    config = load_config(config_folder / "run.yaml", ["arm.urdf=other.urdf"])
    assert Path(config.arm.urdf) == (config_folder / "other.urdf").resolve()


def test_single_values_are_replaced_and_checked(config: Config) -> None:
    changed = with_values(
        config, {"control.path_tolerance_rad": 0.3, "arm.joints": ["shoulder", "elbow"]}, "parameters"
    )
    assert changed.control.path_tolerance_rad == 0.3
    assert config.control.path_tolerance_rad == 0.8
    assert changed == dataclasses.replace(config, control=changed.control)


def test_a_known_path_is_found_beside_the_file_or_where_the_option_was_given(
    edit: Edit, config_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = edit("run.yaml", "practice:\n", "  known_file: figures/line.csv\npractice:\n  vary: [shape]\n")
    assert load_config(file).path.known_file == str((config_folder / "figures" / "line.csv").resolve())
    monkeypatch.chdir(config_folder)
    other = load_config(file, ["path.known_file=other.csv"])
    assert other.path.known_file == str((config_folder / "other.csv").resolve())
    built_in = load_config(file, ["path.known_name=planar_loops"])
    assert (built_in.path.known_name, built_in.path.known_file) == ("planar_loops", "")


def test_what_varies_is_a_list_of_known_things(config_folder: Path) -> None:
    config = load_config(config_folder / "run.yaml", ["practice.vary=[amplitude, speed]"])
    assert config.practice.vary == ("amplitude", "speed")
    with pytest.raises(ConfigError, match=r"practice\.vary.* expected .*'speed' or 'amplitude'"):
        load_config(config_folder / "run.yaml", ["practice.vary=[weight]"])


def test_a_key_of_the_version_before_still_works_with_a_warning(edit: Edit) -> None:
    file = edit("run.yaml", "path_tolerance_rad", "corridor_rad")
    with pytest.warns(
        FutureWarning, match=r"run\.yaml: control\.corridor_rad is called control\.path_tolerance_rad"
    ):
        assert load_config(file).control.path_tolerance_rad == 0.8
    with pytest.warns(
        FutureWarning, match=r"--set control\.corridor_rad=0\.125: control\.corridor_rad is called"
    ):
        config = load_config(config_folder() / "paper.yaml", ["control.corridor_rad=0.125"])
    assert config.control.path_tolerance_rad == 0.125


@pytest.mark.parametrize("key", file_keys())
def test_a_key_declared_as_a_file_is_resolved_stored_in_bags_and_copied_to_the_run(
    key: str, config_folder: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    section, name = key.split(".")
    others = ["practice.vary=[shape]"] if key == "path.known_file" else []
    content = (config_folder / "robots" / "planar_arm.urdf").read_bytes()
    raw = yaml.safe_load((config_folder / "run.yaml").read_text())
    raw["arm"] = yaml.safe_load((config_folder / "arms" / "two_link.yaml").read_text())
    raw["arm"]["urdf"] = "robots/planar_arm.urdf"
    is_list = key == "path.files"
    raw.setdefault(section, {})[name] = ["some.file"] if is_list else "some.file"
    if key in ("path.file", "path.files"):
        del raw["path"]["name"]
    (config_folder / "some.file").write_bytes(content)
    (config_folder / "named.yaml").write_text(yaml.safe_dump(raw))
    named = load_config(config_folder / "named.yaml", others)
    place = f"{key}.0" if is_list else key
    assert file_values(named)[place] == (config_folder / "some.file").resolve()

    monkeypatch.chdir(config_folder)
    value = "[some.file]" if is_list else "some.file"
    option = load_config(config_folder / "run.yaml", [f"{key}={value}", *others])
    assert file_values(option)[place] == (config_folder / "some.file").resolve()

    metadata = {"config": dump_config(create_run_folder(tmp_path / "run", named)), **stored_files(named, 1)}
    shutil.rmtree(tmp_path / "run")
    unpacked = unpacked_config(tmp_path / "run" / "trial_001", metadata, tmp_path)
    assert file_values(unpacked)[place].read_bytes() == content
