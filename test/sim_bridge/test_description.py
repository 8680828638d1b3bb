"""What a URDF says of an arm is what is simulated, or it is refused with one line that says why."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from analytic import PlanarArm

from sim_bridge.arm import SimulatedArm
from tel_ros.core.config import ArmConfig
from tel_ros.core.errors import InputFileError, TelError
from tel_ros.core.plain_urdf import plain_urdf, remarks
from tel_ros.recording.urdf import described, mesh_file

MakeArm = Callable[..., SimulatedArm]

SHOULDER_LIMIT = '<limit lower="-2.9" upper="2.9" effort="20" velocity="15"/>'


def refusal(make_arm: MakeArm, kind: type[TelError], **how: object) -> str:
    """Return the message with which an arm is refused."""
    with pytest.raises(kind) as caught:
        make_arm(**how)
    message = str(caught.value)
    assert "\n" not in message
    return message


def arm_of(urdf: Path, *joints: str) -> ArmConfig:
    values = ((1.0,) * len(joints),) * 3
    springs = dict(
        zip(("stiffness_nm_per_rad", "damping_nms_per_rad", "effort_limit_nm"), values, strict=True)
    )
    return ArmConfig(name="arm", urdf=str(urdf), joints=joints, hand_link="hand", **springs)


@pytest.mark.parametrize(("held", "at_rad"), [({}, 0.0), ({"elbow": np.pi / 2}, np.pi / 2)])
def test_a_joint_beyond_the_named_ones_is_simulated_where_it_is_held(
    make_arm: MakeArm, held: dict[str, float], at_rad: float
) -> None:
    """The arm moves like one whose elbow is welded."""
    arm = make_arm(
        arm={"joints": ("shoulder",), "held": held},
        rate_hz=4000.0, encoder_bits=0, viscous_friction_nms_per_rad=(0.0,),
    )  # fmt: skip
    arm.step([3.0])
    square_m2 = 0.33**2 + 0.165**2 + 2.0 * 0.33 * 0.165 * np.cos(at_rad)
    inertia_kgm2 = 0.05 + 2.0 * 0.165**2 + 0.02 + 1.2 * square_m2
    assert arm.true_velocity_rad_s[0] * 4000.0 == pytest.approx(3.0 / inertia_kgm2, rel=1e-9)


def test_an_axis_of_any_length_is_simulated_like_one_of_length_1(
    make_arm: MakeArm, edited_urdf: Callable[..., Path]
) -> None:
    arms = [make_arm(), make_arm(urdf=edited_urdf({'<axis xyz="0 0 1"/>': '<axis xyz="0 0 3"/>'}))]
    for arm in arms:
        for _ in range(50):
            arm.step([2.0, -1.0])
    assert arms[0].reading() == arms[1].reading()


def test_limits_that_the_file_lacks_are_those_of_the_configuration(
    make_arm: MakeArm, edited_urdf: Callable[..., Path]
) -> None:
    path = edited_urdf({SHOULDER_LIMIT: '<limit effort="0" velocity="0"/>'})
    own = {"position_min_rad": (-0.1, -0.1), "position_max_rad": (0.1, 0.1), "effort_limit_nm": (5.0, 6.0)}
    arm = make_arm(urdf=path, arm=own)
    assert arm.effort_limit_nm == (5.0, 6.0)
    for _ in range(300):
        arm.step([5.0, 0.0])
    assert arm.true_position_rad[0] == pytest.approx(0.1, abs=1e-3), "stopped hard"


@pytest.mark.parametrize(
    ("edits", "said"),
    [
        ({'<mass value="0"/>': '<mass value="0.1"/>'}, ()),
        (
            {'<mass value="0"/>\n      <inertia ixx="0" ixy="0" ixz="0" iyy="0" iyz="0" izz="0"/>':
             '<mass value="0"/>\n      <inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/>'},
            ("links with an <inertia>, but no mass, are taken as written: hand",),
        ),
    ],
)  # fmt: skip
def test_what_the_author_may_not_have_meant_is_said(
    edited_urdf: Callable[..., Path], edits: dict[str, str], said: tuple[str, ...]
) -> None:
    assert remarks(described(arm_of(edited_urdf(edits), "shoulder", "elbow"))) == said


def test_a_shape_without_inertial_is_said_but_a_bare_frame_is_not(
    edited_urdf: Callable[..., Path], planar_arm_urdf: Path
) -> None:
    text = planar_arm_urdf.read_text(encoding="utf-8")
    start = text.index("<inertial>", text.index('<link name="hand">'))
    inertial = text[start : text.index("</inertial>", start) + len("</inertial>")]
    said = remarks(described(arm_of(edited_urdf({inertial: ""}), "shoulder", "elbow")))
    assert said == ("links with a shape, but no <inertial>, are taken as weightless: hand",)
    whole = text[text.index('<link name="hand">') : text.index("</link>", start) + len("</link>")]
    frame = edited_urdf({whole: '<link name="hand"/>'})
    assert remarks(described(arm_of(frame, "shoulder", "elbow"))) == ()


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


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('iyy="0.05"', 'iyy="-0.05"', "link 'upper_arm' has an <inertia> that no body has"),
        ('<mass value="1.2"/>', '<mass value="-1"/>', "link 'forearm' has the mass -1.0; expected"),
        ('<axis xyz="0 0 1"/>', '<axis xyz="0 0 0"/>', "joint 'shoulder' has an <axis> of zeros; expected"),
    ],
)
def test_what_cannot_be_simulated_is_refused_by_the_arm_as_well(
    make_arm: MakeArm, edited_urdf: Callable[..., Path], old: str, new: str, message: str
) -> None:
    path = edited_urdf({old: new})
    assert refusal(make_arm, InputFileError, urdf=path).startswith(f"{path}: {message}")


def test_the_planar_arm_is_described_as_intended(planar_arm_urdf: Path) -> None:
    found = described(arm_of(planar_arm_urdf, "shoulder", "elbow"))
    assert found.limits == (((-2.9, 2.9), 20.0, 15.0),) * 2
    assert found.viscous_friction_nms_per_rad == (0.05, 0.05)
    assert found.coulomb_friction_nm == (0.0, 0.0)


def test_shapes_reach_the_simulator_only_where_they_are_shown(planar_arm_urdf: Path) -> None:
    found = described(arm_of(planar_arm_urdf, "shoulder", "elbow"))
    shown = plain_urdf(found, mesh=lambda name: name)
    assert shown.count("<visual") == 6
    assert "upper_arm_blue" in shown
    assert "<visual" not in plain_urdf(found)


@pytest.mark.parametrize("filename", ["meshes/hand.stl", "package://my_robot/meshes/hand.stl"])
def test_a_mesh_is_found_from_where_the_urdf_lies_and_left_out_if_missing(
    edited_urdf: Callable[..., Path], tmp_path: Path, filename: str
) -> None:
    """The simulator reads a copy of the file that lies elsewhere."""
    path = edited_urdf({'<sphere radius="0.02"/>': f'<mesh filename="{filename}"/>'})
    found = described(arm_of(path, "shoulder", "elbow"))
    assert plain_urdf(found, mesh=partial(mesh_file, path)).count("<visual") == 5
    mesh = tmp_path / "meshes" / "hand.stl"
    mesh.parent.mkdir()
    mesh.touch()
    assert f'<mesh filename="{mesh}"' in plain_urdf(found, mesh=partial(mesh_file, path))
