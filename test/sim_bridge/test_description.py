"""URDF files that cannot be simulated are refused with one line that says why."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from analytic import PlanarArm

from sim_bridge.arm import SimulatedArm
from sim_bridge.description import ArmDescription
from tel_ros.core.errors import ConfigError, InputFileError, TelError

MakeArm = Callable[..., SimulatedArm]

SHOULDER_LIMIT = '<limit lower="-2.9" upper="2.9" effort="20" velocity="15"/>'


def refusal(make_arm: MakeArm, kind: type[TelError], **how: object) -> str:
    """Return the message with which an arm is refused."""
    with pytest.raises(kind) as caught:
        make_arm(**how)
    message = str(caught.value)
    assert "\n" not in message
    return message


def test_a_missing_file_is_named(make_arm: MakeArm, tmp_path: Path) -> None:
    message = refusal(make_arm, InputFileError, urdf=tmp_path / "nowhere.urdf")
    assert (
        message
        == f"{tmp_path / 'nowhere.urdf'}: cannot be read (No such file or directory); expected a URDF file"
    )


def test_a_folder_is_not_a_urdf(make_arm: MakeArm, tmp_path: Path) -> None:
    assert "cannot be read (Is a directory)" in refusal(make_arm, InputFileError, urdf=tmp_path)


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"not xml at all",
        b"\x00\xff\xfe",
        b"<robot",
        b"<sdf/>",
        b'<robot name="r"><link/></robot>',
        b'<robot name="r"><link name="a"><inertial><mass value="heavy"/></inertial></link></robot>',
    ],
    ids=lambda content: content.decode(errors="replace")[:12],
)
def test_a_file_that_is_not_a_urdf_is_named(make_arm: MakeArm, tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "broken.urdf"
    path.write_bytes(content)
    assert refusal(make_arm, InputFileError, urdf=path).startswith(f"{path}: is not a URDF (")


def test_a_joint_that_the_urdf_does_not_have_is_named_with_those_it_has(
    make_arm: MakeArm, planar_arm_urdf: Path
) -> None:
    message = refusal(make_arm, ConfigError, arm={"joints": ("shoulder", "wrist")})
    assert (
        message
        == f"arm.joints is 'wrist'; expected a movable joint of {planar_arm_urdf}, which has shoulder, elbow"
    )


def test_a_fixed_joint_is_not_a_joint_to_move(make_arm: MakeArm) -> None:
    message = refusal(make_arm, ConfigError, arm={"joints": ("shoulder", "elbow", "hand_mount")})
    assert message.startswith("arm.joints is 'hand_mount'; expected a movable joint of")


def test_a_joint_that_carries_a_named_one_must_be_named(make_arm: MakeArm) -> None:
    message = refusal(make_arm, ConfigError, arm={"joints": ("elbow",)})
    assert message.startswith("arm.joints is ['elbow']; expected also 'shoulder', which carries 'elbow'")


def test_a_joint_beyond_the_named_ones_is_held_at_zero_and_that_is_said(
    make_arm: MakeArm, planar_arm_urdf: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """The arm moves like one whose elbow is welded: a stiff rod of 0.66 m."""
    arm = make_arm(
        arm={"joints": ("shoulder",)}, rate_hz=4000.0, encoder_bits=0, viscous_friction_nms_per_rad=(0.0,)
    )
    assert caplog.messages == [f"{planar_arm_urdf}: held at 0, because arm.joints does not name them: elbow"]
    arm.step([3.0])
    inertia_kgm2 = 0.05 + 2.0 * 0.165**2 + 0.02 + 1.2 * (0.33 + 0.165) ** 2
    assert arm.true_velocity_rad_s[0] * 4000.0 == pytest.approx(3.0 / inertia_kgm2, rel=1e-9)


def test_a_joint_that_cannot_be_held_at_zero_is_refused(
    make_arm: MakeArm, edited_urdf: Callable[..., Path]
) -> None:
    path = edited_urdf({SHOULDER_LIMIT: '<limit lower="0.2" upper="1" effort="20" velocity="15"/>'})
    text = path.read_text(encoding="utf-8")  # the elbow has the same limits
    path.write_text(text.replace('lower="0.2"', 'lower="-1"', 1), encoding="utf-8")
    message = refusal(make_arm, InputFileError, urdf=path, arm={"joints": ("shoulder",)})
    assert message.startswith(
        f"{path}: joint 'elbow' has the range 0.2 to 1.0; expected a range with 0 in it"
    )


@pytest.mark.parametrize(
    ("edits", "said"),
    [
        ({'<mass value="0"/>': '<mass value="0.1"/>'}, []),
        (
            {'<mass value="0"/>\n      <inertia ixx="0" ixy="0" ixz="0" iyy="0" iyz="0" izz="0"/>':
             '<mass value="0"/>\n      <inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/>'},
            ["link 'hand' has an <inertia>, but no mass: it is taken as written"],
        ),
    ],
)  # fmt: skip
def test_what_the_author_may_not_have_meant_is_said(
    edited_urdf: Callable[..., Path], edits: dict[str, str], said: list[str]
) -> None:
    assert list(ArmDescription(edited_urdf(edits), ("shoulder", "elbow"), "hand").remarks) == said


def test_a_shape_without_inertial_is_said_but_a_bare_frame_is_not(
    edited_urdf: Callable[..., Path], planar_arm_urdf: Path
) -> None:
    text = planar_arm_urdf.read_text(encoding="utf-8")
    start = text.index("<inertial>", text.index('<link name="hand">'))
    inertial = text[start : text.index("</inertial>", start) + len("</inertial>")]
    shape = edited_urdf({inertial: ""})
    remarks = ArmDescription(shape, ("shoulder", "elbow"), "hand").remarks
    assert remarks == ("link 'hand' has a shape, but no <inertial>: it is taken as weightless",)
    whole = text[text.index('<link name="hand">') : text.index("</link>", start) + len("</link>")]
    frame = edited_urdf({whole: '<link name="hand"/>'})
    assert ArmDescription(frame, ("shoulder", "elbow"), "hand").remarks == ()


def test_an_inertia_without_mass_acts_as_written(make_arm: MakeArm, edited_urdf: Callable[..., Path]) -> None:
    """The Panda of pybullet_data has such links."""
    zero = '<mass value="0"/>\n      <inertia ixx="0" ixy="0" ixz="0" iyy="0" iyz="0" izz="0"/>'
    path = edited_urdf({zero: zero.replace('"0" i', '"0.1" i').replace('izz="0"', 'izz="0.1"')
                        .replace('ixy="0.1"', 'ixy="0"').replace('ixz="0.1"', 'ixz="0"')
                        .replace('iyz="0.1"', 'iyz="0"')})  # fmt: skip
    still = {"rate_hz": 4000.0, "encoder_bits": 0, "viscous_friction_nms_per_rad": (0.0, 0.0)}
    arm = make_arm(urdf=path, **still)
    arm.set_state([0.0, 0.0], [0.0, 0.0])
    # Straight and at rest: no Coriolis torques, M a = tau with 0.1 kg·m² more in each element of M.
    tau = np.array([3.0, 1.0])
    arm.step(tau)
    acceleration = np.array(arm.true_velocity_rad_s) * 4000.0
    expected = np.linalg.solve(PlanarArm().mass_matrix(np.zeros(2)) + 0.1, tau)
    np.testing.assert_allclose(acceleration, expected, rtol=1e-9)


def test_a_hand_link_that_the_urdf_does_not_have_is_named_with_the_links_it_has(make_arm: MakeArm) -> None:
    message = refusal(make_arm, ConfigError, arm={"hand_link": "gripper"})
    assert message.startswith("arm.hand_link is 'gripper'; expected a link of")
    assert message.endswith("which has base, upper_arm, forearm, hand")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            'name="elbow" type="revolute"',
            'name="elbow" type="prismatic"',
            "joint 'elbow' is prismatic; expected one of the types revolute and continuous",
        ),
        (SHOULDER_LIMIT, "", "joint 'shoulder' has no <limit>; expected a <limit> in every revolute joint"),
        (
            SHOULDER_LIMIT,
            '<limit lower="1" upper="-1" effort="20" velocity="15"/>',
            "joint 'shoulder' has the range 1.0 to -1.0; expected finite limits, lower below upper",
        ),
        (
            SHOULDER_LIMIT,
            '<limit lower="-1" upper="nan" effort="20" velocity="15"/>',
            "joint 'shoulder' has the range -1.0 to nan; expected",
        ),
        (
            SHOULDER_LIMIT,
            '<limit lower="-1" upper="1" effort="0" velocity="15"/>',
            "joint 'shoulder' has the effort limit 0.0; expected a finite number of N·m above 0",
        ),
        ('damping="0.05"', 'damping="-1"', "joint 'shoulder' has the damping -1.0; expected"),
        ('friction="0"', 'friction="nan"', "joint 'shoulder' has the friction nan; expected"),
        (
            "<axis",
            '<mimic joint="elbow"/><axis',
            "joint 'shoulder' mimics 'elbow'; expected joints that move on their own",
        ),
        (
            '<child link="hand"/>',
            '<child link="tool"/>',
            "joint 'hand_mount' is attached to 'tool'; expected links",
        ),
        (
            '<child link="hand"/>',
            '<child link="upper_arm"/>',
            "link 'upper_arm' has two parents; expected one",
        ),
        ('<parent link="base"/>', '<parent link="hand"/>', "its links form no tree"),
        (
            '<link name="hand">',
            '<link name="forearm">',
            "link 'forearm' is there twice; expected each link once",
        ),
        (
            'iyy="0.02" iyz="0" izz="0.02"',
            'iyy="0.02" iyz="0" izz="0.5"',
            "link 'forearm' has an <inertia> that no body has (principal moments 0.002, 0.02, 0.5 ",
        ),
        (
            'iyy="0.05"',
            'iyy="-0.05"',
            "link 'upper_arm' has an <inertia> that no body has (principal moments -0.05, 0.005, 0.05 kg·m²)",
        ),
        ('<mass value="1.2"/>', '<mass value="nan"/>', "link 'forearm' has the mass nan; expected"),
        ('<mass value="1.2"/>', '<mass value="-1"/>', "link 'forearm' has the mass -1.0; expected"),
    ],
)
def test_what_cannot_be_simulated_is_named(
    make_arm: MakeArm, edited_urdf: Callable[..., Path], old: str, new: str, message: str
) -> None:
    path = edited_urdf({old: new})
    assert refusal(make_arm, InputFileError, urdf=path).startswith(f"{path}: {message}")


def test_a_joint_that_moves_no_mass_is_refused(
    make_arm: MakeArm, edited_urdf: Callable[..., Path], planar_arm_urdf: Path
) -> None:
    text = planar_arm_urdf.read_text(encoding="utf-8")
    start = text.index("<inertial>", text.index('<link name="forearm">'))
    inertial = text[start : text.index("</inertial>", start) + len("</inertial>")]
    path = edited_urdf({inertial: ""})
    assert "a joint that moves neither mass nor inertia" in refusal(make_arm, InputFileError, urdf=path)


def test_the_planar_arm_is_described_as_intended(planar_arm_urdf: Path) -> None:
    described = ArmDescription(planar_arm_urdf, ("shoulder", "elbow"), "hand")
    assert described.position_min_rad == (-2.9, -2.9)
    assert described.position_max_rad == (2.9, 2.9)
    assert described.effort_limit_nm == (20.0, 20.0)
    assert described.viscous_friction_nms_per_rad == (0.05, 0.05)
    assert described.coulomb_friction_nm == (0.0, 0.0)


def test_shapes_reach_the_simulator_only_where_they_are_shown(planar_arm_urdf: Path) -> None:
    described = ArmDescription(planar_arm_urdf, ("shoulder", "elbow"), "hand")
    shown = described.for_simulation(inertia_scale=1.0, payload_kg=0.0, visuals=True)
    hidden = described.for_simulation(inertia_scale=1.0, payload_kg=0.0, visuals=False)
    assert shown.count("<visual") == 6
    assert "upper_arm_blue" in shown
    assert "<visual" not in hidden


@pytest.mark.parametrize("filename", ["meshes/hand.stl", "package://my_robot/meshes/hand.stl"])
def test_a_mesh_is_found_from_where_the_urdf_lies(
    edited_urdf: Callable[..., Path], tmp_path: Path, filename: str
) -> None:
    """The simulator reads a copy of the file that lies elsewhere."""
    mesh = tmp_path / "meshes" / "hand.stl"
    mesh.parent.mkdir()
    mesh.touch()
    path = edited_urdf({'<sphere radius="0.02"/>': f'<mesh filename="{filename}"/>'})
    described = ArmDescription(path, ("shoulder", "elbow"), "hand")
    text = described.for_simulation(inertia_scale=1.0, payload_kg=0.0, visuals=True)
    assert f'<mesh filename="{mesh}"' in text
