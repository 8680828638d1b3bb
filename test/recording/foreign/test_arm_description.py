"""Joints that were held are described as fixed where they were."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import sim_bridge
from tel_ros.core.errors import ConfigError, InputFileError
from tel_ros.recording.foreign.arm_description import arm_description
from tel_ros.recording.urdf import chain_to_hand, read_urdf

PLANAR_ARM_3 = Path(sim_bridge.__file__).parent / "urdf" / "planar_arm_3.urdf"
ALL = tuple(joint.name for joint in read_urdf(PLANAR_ARM_3).joints if joint.type == "revolute")
SLIDING = """
<robot name="sliding"><link name="base"/><link name="carriage"/><link name="hand"/>
<joint name="rail" type="prismatic"><parent link="base"/><child link="carriage"/>
<origin xyz="0 0 1" rpy="0 0 1.5707963267948966"/><axis xyz="1 0 0"/>
<limit lower="0" upper="1" effort="1" velocity="1"/></joint>
<joint name="turn" type="revolute"><parent link="carriage"/><child link="hand"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>
"""


def hand_m(urdf: Path, joints: tuple[str, ...], position: list[float], hand: str) -> np.ndarray:
    return chain_to_hand(read_urdf(urdf), joints, hand).hand_positions(np.array([position]))[0]


def test_the_hand_is_where_it_was_with_the_joint_held(tmp_path: Path) -> None:
    hand = list(read_urdf(PLANAR_ARM_3).link_map)[-1]
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
    assert [j.name for j in read_urdf(tmp_path / "fixed.urdf").joints if j.type == "revolute"] == list(
        ALL[:2]
    )


def test_a_joint_that_moved_must_be_learned_too() -> None:
    with pytest.raises(ConfigError, match=f"expected also {ALL[1]}, which moved by 0.4 rad"):
        arm_description(PLANAR_ARM_3, (ALL[0], ALL[2]), {ALL[1]: (0.1, 0.5)})


def test_joints_that_the_urdf_lacks_are_named() -> None:
    with pytest.raises(ConfigError, match=r"joints is 'joint_9'; expected movable joints of .*it has"):
        arm_description(PLANAR_ARM_3, [*ALL, "joint_9"], {})
    with pytest.raises(InputFileError, match="there is no such file"):
        arm_description(Path("nowhere.urdf"), ALL, {})
