"""What the project takes from an arm's URDF."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

import sim_bridge
from tel_ros.core.arm_description import ArmDescription
from tel_ros.core.errors import ConfigError, InputFileError
from tel_ros.core.kinematics import SerialChain
from tel_ros.recording.shared_files import named_file
from tel_ros.recording.urdf import arm_description, read_urdf

JOINTS = ("shoulder", "elbow")


@pytest.fixture
def planar_arm(config_folder: Path) -> Path:
    """A copy of the project's arm."""
    return config_folder / "robots" / "planar_arm.urdf"


def edited(file: Path, old: str, new: str, count: int = 1) -> Path:
    text = file.read_text(encoding="utf-8")
    assert old in text
    file.write_text(text.replace(old, new, count), encoding="utf-8")
    return file


def chain(file: Path, joints: Sequence[str] = JOINTS, hand: str = "hand") -> SerialChain:
    return ArmDescription(read_urdf(file), joints).chain(hand)


def test_the_hand_is_where_the_formula_of_the_planar_arm_says(planar_arm: Path) -> None:
    q = np.random.default_rng(0).uniform(-2.5, 2.5, (10, 2))
    both = q.sum(axis=1)
    expected = 0.33 * np.column_stack(
        [np.cos(q[:, 0]) + np.cos(both), np.sin(q[:, 0]) + np.sin(both), np.zeros(10)]
    )
    found = chain(planar_arm)
    np.testing.assert_allclose(found.hand_positions(q), expected, atol=1e-14)  # rounding only
    swapped = chain(planar_arm, ("elbow", "shoulder"))
    np.testing.assert_allclose(swapped.hand_positions(q[:, ::-1]), expected, atol=1e-14)


def test_origins_turn_in_fixed_axes_roll_first(planar_arm: Path) -> None:
    """A roll of 90° and then a yaw of 90°: x goes to y and y goes to z."""
    half_turn = 'rpy="1.5707963267948966 0 1.5707963267948966"'
    urdf = edited(planar_arm, '<origin xyz="0 0 0"/>', f'<origin xyz="0 0 0.5" {half_turn}/>')
    found = chain(urdf)
    np.testing.assert_allclose(found.hand_positions(np.zeros((1, 2))), [[0.0, 0.66, 0.5]], atol=1e-12)
    bent = np.array([[0.0, np.pi / 2]])  # the forearm along the upper arm's y
    np.testing.assert_allclose(found.hand_positions(bent), [[0.0, 0.33, 0.83]], atol=1e-12)


def test_a_missing_file_is_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(InputFileError, match=r"arm\.urdf: there is no such file; expected a URDF file"):
        read_urdf(tmp_path / "arm.urdf")


def test_a_folder_and_what_is_too_large_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputFileError, match="is a folder; expected a URDF file"):
        read_urdf(tmp_path)
    with (tmp_path / "huge.urdf").open("wb") as file:
        file.truncate(200_000_000)
    with pytest.raises(InputFileError, match=r"huge\.urdf: has 200 MB; expected a URDF file"):
        read_urdf(tmp_path / "huge.urdf")


def test_a_file_in_a_python_package_is_found_without_importing_the_package(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    package = tmp_path / "robots_to_test_with"
    (package / "urdf").mkdir(parents=True)
    (package / "__init__.py").write_text("raise RuntimeError('imported')")
    (package / "urdf" / "arm.urdf").touch()
    monkeypatch.syspath_prepend(tmp_path)
    found = named_file("package://robots_to_test_with/urdf/arm.urdf", Path("/anywhere"))
    assert found == package / "urdf" / "arm.urdf"
    with pytest.raises(InputFileError) as refusal:
        named_file("package://robots_to_test_with/arm.urdf", Path("/anywhere"))
    complaint = f"no such file in {package}; expected a file of a package (key arm.urdf)"
    assert str(refusal.value) == f"package://robots_to_test_with/arm.urdf: {complaint}"


def test_a_file_in_a_ros_package_is_found_in_its_share_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "share" / "my_arm_description" / "arm.urdf"
    file.parent.mkdir(parents=True)
    file.touch()
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"/nowhere:{tmp_path}")
    assert named_file("package://my_arm_description/arm.urdf", Path()) == file


@pytest.mark.parametrize(
    "name", ["package://not_there_at_all/a.urdf", "package://no.such/a.urdf", "package:///a"]
)
def test_a_package_that_is_not_installed_is_refused_by_name(name: str) -> None:
    with pytest.raises(InputFileError, match=r"no package '.*' is installed; expected a file of a package"):
        named_file(name, Path())


PLANAR_ARM_3 = Path(sim_bridge.__file__).parent / "urdf" / "planar_arm_3.urdf"
ALL = tuple(name for name, joint in read_urdf(PLANAR_ARM_3).joints.items() if joint.kind == "revolute")
SLIDING = """
<robot name="sliding"><link name="base"/><link name="carriage"/><link name="hand"/>
<joint name="rail" type="prismatic"><parent link="base"/><child link="carriage"/>
<origin xyz="0 0 1" rpy="0 0 1.5707963267948966"/><axis xyz="1 0 0"/>
<limit lower="0" upper="1" effort="1" velocity="1"/></joint>
<joint name="turn" type="revolute"><parent link="carriage"/><child link="hand"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>
"""


def hand_m(urdf: Path, joints: tuple[str, ...], position: list[float], hand: str) -> np.ndarray:
    return chain(urdf, joints, hand).hand_positions(np.array([position]))[0]


def test_the_hand_is_where_it_was_with_the_joint_held(tmp_path: Path) -> None:
    hand = list(read_urdf(PLANAR_ARM_3).links)[-1]
    learned = (ALL[0], ALL[2])
    text, assumed = arm_description(PLANAR_ARM_3, learned, {ALL[1]: (0.698, 0.702)})
    assert assumed == []
    (tmp_path / "fixed.urdf").write_text(text)
    found = hand_m(tmp_path / "fixed.urdf", learned, [0.3, -0.4], hand)
    np.testing.assert_allclose(found, hand_m(PLANAR_ARM_3, ALL, [0.3, 0.7, -0.4], hand), atol=1e-12)


def test_a_slide_that_was_held_keeps_its_place(tmp_path: Path) -> None:
    (tmp_path / "arm.urdf").write_text(SLIDING)
    text, _ = arm_description(tmp_path / "arm.urdf", ["turn"], {"rail": (0.5, 0.5)})
    (tmp_path / "fixed.urdf").write_text(text)
    np.testing.assert_allclose(
        hand_m(tmp_path / "fixed.urdf", ("turn",), [0.0], "hand"), [0, 0.5, 1], atol=1e-12
    )


def test_a_joint_that_nobody_recorded_is_said_to_be_at_zero(tmp_path: Path) -> None:
    text, assumed = arm_description(PLANAR_ARM_3, ALL[:2], {})
    assert assumed == [f"{ALL[2]} was not recorded: the arm is described with it at 0"]
    (tmp_path / "fixed.urdf").write_text(text)
    found = read_urdf(tmp_path / "fixed.urdf").joints.values()
    assert [joint.name for joint in found if joint.kind == "revolute"] == list(ALL[:2])


def test_a_joint_that_moved_must_be_learned_too() -> None:
    with pytest.raises(ConfigError, match=f"expected also {ALL[1]}, which moved by 0.4 rad"):
        arm_description(PLANAR_ARM_3, (ALL[0], ALL[2]), {ALL[1]: (0.1, 0.5)})


def test_joints_that_the_urdf_lacks_are_named() -> None:
    with pytest.raises(ConfigError, match=r"joints is 'joint_9'; expected a movable joint .*it has"):
        arm_description(PLANAR_ARM_3, [*ALL, "joint_9"], {})
    with pytest.raises(InputFileError, match="there is no such file"):
        arm_description(Path("nowhere.urdf"), ALL, {})
