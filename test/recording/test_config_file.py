"""Reading a practice run: every complaint is one line with file or option, key, value and expectation."""

from __future__ import annotations

import dataclasses
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

from tel_ros.core.config import Config, file_keys, file_values
from tel_ros.core.errors import ConfigError, InputFileError
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


def complaint(file: Path, *overrides: str) -> str:
    """Return what is said about a configuration that must be refused."""
    with pytest.raises((ConfigError, InputFileError)) as refusal:
        load_config(file, overrides)
    text = str(refusal.value)
    assert "\n" not in text, "a complaint is one line"
    assert "; expected " in text
    return text


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


def test_limits_in_the_arm_description_take_the_place_of_the_urdfs(edit: Edit) -> None:
    file = edit("arms/two_link.yaml", "hand_link: hand\n", "hand_link: hand\nvelocity_limit_rad_s: [3, 4]\n")
    arm = load_config(file).arm
    assert arm.velocity_limit_rad_s == (3.0, 4.0)
    assert arm.position_max_rad == (2.9, 2.9)


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [
        ("effort_limit_nm", "[20.0, 20.1]", "0 to 20 for elbow, as in the URDF"),
        ("position_min_rad", "[-3.0, -2.9]", "-2.9 to 2.9 for shoulder, as in the URDF"),
        ("position_max_rad", "[2.9, 2.91]", "-2.9 to 2.9 for elbow, as in the URDF"),
    ],
)
def test_limits_beyond_the_urdfs_are_refused(config_folder: Path, key: str, value: str, said: str) -> None:
    text = complaint(config_folder / "run.yaml", f"arm.{key}={value}")
    assert text == f"--set arm.{key}={value}: arm.{key} is {value}; expected {said}"


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


def test_a_missing_file_is_refused_by_name(tmp_path: Path) -> None:
    assert (
        complaint(tmp_path / "no.yaml") == f"{tmp_path}/no.yaml: there is no such file; expected a YAML file"
    )


def test_a_missing_arm_description_is_refused_by_name(config_folder: Path, edit: Edit) -> None:
    text = complaint(edit("run.yaml", "arms/two_link.yaml", "arms/three_link.yaml"))
    assert text.startswith(f"{config_folder}/arms/three_link.yaml: there is no such file")


@pytest.mark.parametrize("content", ["a: [1", "a: b: c", "\x00", "\ta: 1"])
def test_a_file_that_is_no_yaml_is_refused_by_name(config_folder: Path, content: str) -> None:
    (config_folder / "run.yaml").write_text(content)
    assert complaint(config_folder / "run.yaml").startswith(f"{config_folder}/run.yaml: not readable as YAML")


def test_a_file_that_is_no_text_is_refused_by_name(config_folder: Path) -> None:
    (config_folder / "run.yaml").write_bytes(b"\xff\xfe\x80\x81")
    assert complaint(config_folder / "run.yaml").startswith(f"{config_folder}/run.yaml: not readable as YAML")


@pytest.mark.parametrize(("content", "kind"), [("", "NoneType"), ("- a\n- b", "list"), ("words", "str")])
def test_a_file_without_keys_is_refused(config_folder: Path, content: str, kind: str) -> None:
    (config_folder / "run.yaml").write_text(content)
    assert complaint(config_folder / "run.yaml").endswith(f"run.yaml: holds {kind}; expected keys and values")


def test_an_unknown_section_is_refused_with_the_known_ones(edit: Edit) -> None:
    file = edit("run.yaml", "control:", "contrl:")
    text = complaint(file)
    assert text.startswith(
        f"{file}: contrl is {{'path_tolerance_rad': 0.8}}; expected a known key: arm, path, run, "
    )


def test_an_unknown_key_in_a_section_is_refused_with_the_known_ones(edit: Edit) -> None:
    file = edit("run.yaml", "path_tolerance_rad", "coridor_rad")
    text = complaint(file)
    assert text.startswith(
        f"{file}: control.coridor_rad is 0.8; expected a known key: rate_hz, path_tolerance_rad, "
    )


def test_an_unknown_key_of_the_arm_is_blamed_on_the_file_of_the_arm(config_folder: Path, edit: Edit) -> None:
    text = complaint(edit("arms/two_link.yaml", "name:", "colour: red\nname:"))
    assert text.startswith(
        f"{config_folder}/arms/two_link.yaml: arm.colour is 'red'; expected a known key: name,"
    )


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("trials: 3", "trials: three", "practice.trials is 'three'; expected a whole number"),
        ("trials: 3", "trials: 2.5", "practice.trials is 2.5; expected a whole number"),
        ("trials: 3", "trials: [3]", "practice.trials is [3]; expected a whole number"),
        ("trials: 3", "trials:", "practice.trials is None; expected a whole number"),
        ("trials: 3", "trials: true", "practice.trials is True; expected a whole number"),
        (
            "path_tolerance_rad: 0.8",
            "path_tolerance_rad: false",
            "control.path_tolerance_rad is False; expected a finite number above 0",
        ),
        ("trials: 3", "trials: 0", "practice.trials is 0; expected a whole number of at least 1"),
        (
            "trials: 3",
            "strategy: fast",
            "practice.strategy is 'fast'; expected one of adaptive_extension, direct, subtasks, ",
        ),
        (
            "path_tolerance_rad: 0.8",
            "path_tolerance_rad: wide",
            "control.path_tolerance_rad is 'wide'; expected a finite number above 0",
        ),
        (
            "path_tolerance_rad: 0.8",
            "path_tolerance_rad: .nan",
            "control.path_tolerance_rad is nan; expected a finite number above 0",
        ),
        (
            "path_tolerance_rad: 0.8",
            "path_tolerance_rad: .inf",
            "control.path_tolerance_rad is inf; expected a finite number above 0",
        ),
        ("control:\n  path_tolerance_rad: 0.8", "control: 5", "control is 5; expected keys and values"),
        ("seed: 7", "seed: -1", "seed is -1; expected a whole number of at least 0"),
        ("seed: 7", "sim: {gui: maybe}", "sim.gui is 'maybe'; expected true or false"),
        ("name: planar_loops", "name: ''", "path.name is ''; expected either a name or a file"),
        (
            "seed: 7",
            "sim: {physics_rate_hz: 750}",
            "sim.physics_rate_hz is 750.0; expected a whole multiple of control.rate_hz = 500.0",
        ),
    ],
)
def test_a_wrong_value_is_refused_with_file_key_value_and_expectation(
    edit: Edit, old: str, new: str, said: str
) -> None:
    file = edit("run.yaml", old, new)
    assert complaint(file).startswith(f"{file}: {said}")


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (
            "joints: [shoulder, elbow]",
            "joints: shoulder",
            "arm.joints is 'shoulder'; expected a list, each element text",
        ),
        ("[1.5, 1.5]", "[1.5, x]", "arm.damping_nms_per_rad.1 is 'x'; expected a number"),
        (
            "[1.5, 1.5]",
            "[1.5, true]",
            "arm.damping_nms_per_rad.1 is True; expected a number",
        ),
        ("[1.5, 1.5]", "[1.5]", "arm.damping_nms_per_rad is [1.5]; expected 2 finite numbers of at least 0"),
        (
            "[20.0, 20.0]",
            "[20.0, .nan]",
            "arm.effort_limit_nm is [20.0, nan]; expected finite numbers above 0",
        ),
        ("name: two_link\n", "", "arm.name is 'missing'; expected text"),
        (
            "hand_link: hand",
            "hand_link: foot",
            "arm.hand_link is 'foot'; expected a link of the URDF (it has base, ",
        ),
        (
            "[shoulder, elbow]",
            "[shoulder, wrist]",
            "arm.joints is 'wrist'; expected a movable joint of the URDF",
        ),
    ],
)
def test_a_wrong_value_of_the_arm_is_blamed_on_the_file_of_the_arm(
    config_folder: Path, edit: Edit, old: str, new: str, said: str
) -> None:
    file = edit("arms/two_link.yaml", old, new)
    assert complaint(file).startswith(f"{config_folder}/arms/two_link.yaml: {said}")


def test_a_run_without_an_arm_is_refused(edit: Edit) -> None:
    file = edit("run.yaml", "arm: arms/two_link.yaml\n", "")
    assert complaint(file).startswith(f"{file}: arm is 'missing'; expected keys and values")


@pytest.mark.parametrize(
    ("option", "said"),
    [
        (
            "control.path_tolerance_rad=-1",
            "control.path_tolerance_rad is -1.0; expected a finite number above 0",
        ),
        (
            "control.path_tolerance_rad=",
            "control.path_tolerance_rad is None; expected a finite number",
        ),
        ("control.coridor_rad=1", "control.coridor_rad is 1; expected a known key: rate_hz, "),
        ("contrl.path_tolerance_rad=1", "contrl is {'path_tolerance_rad': 1}; expected a known key: arm, "),
        ("seed.x=1", "seed.x is 1; expected a key (seed is a single value)"),
        ("learning.rate=1.5", "learning.rate is 1.5; expected a number above 0 and up to 1"),
        ("learning=lms", "learning is 'lms'; expected keys and values"),
        (
            "sim.coulomb_friction_nm=[0.1]",
            "sim.coulomb_friction_nm is [0.1]; expected nothing, or 2 finite numbers of at least 0, one for",
        ),
        ("arm.hand_link=foot", "arm.hand_link is 'foot'; expected a link of the URDF"),
        ("arm.damping_nms_per_rad=[1", "arm.damping_nms_per_rad is '[1'; expected a value in YAML"),
    ],
)
def test_a_wrong_option_is_refused_and_named(config_folder: Path, option: str, said: str) -> None:
    text = complaint(config_folder / "run.yaml", "practice.trials=5", option)
    assert text.startswith(f"--set {option}: {said}")


def test_a_value_that_does_not_fit_an_option_is_blamed_on_its_own_file(config_folder: Path) -> None:
    text = complaint(config_folder / "run.yaml", "arm.joints=[shoulder]")
    said = "arm.stiffness_nm_per_rad is [15.0, 15.0]; expected 1 finite numbers above 0, one for each of"
    assert text.startswith(f"{config_folder}/arms/two_link.yaml: {said}")


@pytest.mark.parametrize("option", ["control.path_tolerance_rad", "=5", "", " =5"])
def test_an_option_that_is_no_assignment_is_refused_with_an_example(config_folder: Path, option: str) -> None:
    text = complaint(config_folder / "run.yaml", option)
    assert text == f"--set is {option!r}; expected an assignment such as control.path_tolerance_rad=0.5"


def test_a_missing_urdf_is_refused_by_name_and_key(config_folder: Path, edit: Edit) -> None:
    text = complaint(edit("arms/two_link.yaml", "planar_arm.urdf", "plain_arm.urdf"))
    assert text.startswith(
        f"{config_folder}/robots/plain_arm.urdf: there is no such file; expected a URDF file"
    )
    assert "arm.urdf" in text


@pytest.mark.parametrize("content", ["", "not XML <", "<sdf/>", "<robot/>"])
def test_a_file_that_is_no_urdf_is_refused_by_name(config_folder: Path, content: str) -> None:
    (config_folder / "robots" / "planar_arm.urdf").write_text(content)
    text = complaint(config_folder / "run.yaml")
    assert text.startswith(f"{config_folder}/")
    assert ".urdf" in text or "the URDF" in text


def test_a_urdf_whose_links_form_no_tree_is_refused(config_folder: Path, edit: Edit) -> None:
    file = edit(
        "robots/planar_arm.urdf", '<link name="base">', '<link name="floating"/>\n  <link name="base">'
    )
    assert "planar_arm.urdf" in complaint(file)


def test_single_values_are_replaced_and_checked(config: Config) -> None:
    changed = with_values(
        config, {"control.path_tolerance_rad": 0.3, "arm.joints": ["shoulder", "elbow"]}, "parameters"
    )
    assert changed.control.path_tolerance_rad == 0.3
    assert config.control.path_tolerance_rad == 0.8
    assert changed == dataclasses.replace(config, control=changed.control)


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [
        (
            "control.path_tolerance_rad",
            -1.0,
            "control.path_tolerance_rad is -1.0; expected a finite number above 0",
        ),
        ("control.coridor_rad", 1.0, "control.coridor_rad is 1.0; expected a known key: rate_hz"),
        (
            "contrl.path_tolerance_rad",
            1.0,
            "contrl is {'path_tolerance_rad': 1.0}; expected a known key: arm",
        ),
        ("seed", "x", "seed is 'x'; expected a whole number"),
    ],
)
def test_a_wrong_single_value_is_refused_with_where_it_came_from(
    config: Config, key: str, value: Any, said: str
) -> None:
    with pytest.raises(ConfigError) as refusal:
        with_values(config, {key: value}, "parameter of ep_controller")
    assert str(refusal.value).startswith(f"parameter of ep_controller: {said}")


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
    raw.setdefault(section, {})[name] = "some.file"
    if key == "path.file":
        del raw["path"]["name"]
    (config_folder / "some.file").write_bytes(content)
    (config_folder / "named.yaml").write_text(yaml.safe_dump(raw))
    named = load_config(config_folder / "named.yaml", others)
    assert file_values(named)[key] == (config_folder / "some.file").resolve()

    monkeypatch.chdir(config_folder)
    option = load_config(config_folder / "run.yaml", [f"{key}=some.file", *others])
    assert file_values(option)[key] == (config_folder / "some.file").resolve()

    metadata = {"config": dump_config(create_run_folder(tmp_path / "run", named)), **stored_files(named, 1)}
    shutil.rmtree(tmp_path / "run")
    unpacked = unpacked_config(tmp_path / "run" / "trial_001", metadata, tmp_path)
    assert file_values(unpacked)[key].read_bytes() == content
