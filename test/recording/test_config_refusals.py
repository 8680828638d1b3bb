"""What is wrong with a practice run is told in one line: file or option, key, value and expectation."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tel_ros.core.config import Config
from tel_ros.core.errors import ConfigError, InputFileError
from tel_ros.recording.config_file import (
    load_config,
    with_values,
)

Edit = Callable[[str, str, str], Path]


def complaint(file: Path, *overrides: str) -> str:
    """Return what is said about a configuration that must be refused."""
    with pytest.raises((ConfigError, InputFileError)) as refusal:
        load_config(file, overrides)
    text = str(refusal.value)
    assert "\n" not in text, "a complaint is one line"
    assert "; expected " in text
    return text


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


@pytest.mark.parametrize(
    ("content", "found"), [("", "is empty"), ("- a\n- b", "holds ['a', 'b']"), ("words", "holds 'words'")]
)
def test_a_file_without_keys_is_refused_in_words_of_its_own(
    config_folder: Path, content: str, found: str
) -> None:
    (config_folder / "run.yaml").write_text(content)
    assert complaint(config_folder / "run.yaml").endswith(f"run.yaml: {found}; expected keys and values")


def test_a_folder_is_no_configuration_and_is_said_to_be_one(config_folder: Path) -> None:
    assert complaint(config_folder) == f"{config_folder}: is a folder; expected a YAML file"


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
        ("practice.strategy", "foo", "practice.strategy is 'foo'; expected"),
    ],
)
def test_a_wrong_single_value_is_refused_with_where_it_came_from(
    config: Config, key: str, value: Any, said: str
) -> None:
    with pytest.raises(ConfigError) as refusal:
        with_values(config, {key: value}, "parameter of ep_controller")
    assert str(refusal.value).startswith(f"parameter of ep_controller: {said}")
