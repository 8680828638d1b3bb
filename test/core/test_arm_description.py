"""What a URDF file may be and say, and what the arm is that it describes: for all readers the same."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np
import pytest

from tel_ros.core.arm_description import ArmDescription
from tel_ros.core.config import ArmConfig
from tel_ros.core.errors import TelError
from tel_ros.core.learning.rigid_body import RigidBodyRegressor
from tel_ros.core.plain_urdf import check_dynamics, inertial, plain_urdf
from tel_ros.core.urdf import Urdf

LIMIT = '<limit lower="-1" upper="2" effort="20" velocity="3"/>'
BODY = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1"/></inertial>'
FINGER = '<limit lower="0.015" upper="0.037" effort="1" velocity="1"/>'


def joint(name: str, parent: str, child: str, inside: str = LIMIT, kind: str = "revolute") -> str:
    ends = f'<parent link="{parent}"/><child link="{child}"/>'
    return (
        f'<joint name="{name}" type="{kind}">{ends}<origin xyz="1 0 0"/><axis xyz="0 0 1"/>{inside}</joint>'
    )


def robot(*joints: str, links: Sequence[str] = ("base", "arm", "hand", "finger", "thumb")) -> str:
    bodies = "".join(f'<link name="{link}">{BODY}</link>' for link in links)
    return f'<robot name="r">{bodies}{"".join(joints)}</robot>'


ARM = (
    joint("shoulder", "base", "arm"),
    joint("elbow", "arm", "hand"),
    joint("slide", "hand", "finger", FINGER, "prismatic"),
    joint("twin", "hand", "thumb", '<mimic joint="slide" multiplier="-2" offset="0.1"/>', "prismatic"),
)


def config(**values: object) -> ArmConfig:
    usual = {"stiffness_nm_per_rad": (1.0, 1.0), "damping_nms_per_rad": (1.0, 1.0)}
    named = {
        "name": "r",
        "joints": ("shoulder", "elbow"),
        "hand_link": "thumb",
        "effort_limit_nm": (1.0, 1.0),
    }
    return ArmConfig(**{**usual, **named, **values})  # type: ignore[arg-type]


def described(text: str | bytes, **values: object) -> ArmDescription:
    content = text.encode() if isinstance(text, str) else text
    return ArmDescription.of(Urdf(content, "arm.urdf"), config(**values))


def complaint(text: str | bytes, **values: object) -> str:
    """Return why an arm cannot be simulated, in one line."""
    with pytest.raises(TelError) as refusal:
        arm = described(text, **values)
        arm.filled(config(**values))
        check_dynamics(arm, "hand")
    assert "\n" not in str(refusal.value)
    return str(refusal.value)


@pytest.mark.parametrize(
    "codec", ["utf-8", "utf-8-sig", "iso-8859-1", "windows-1252", "utf-16", "utf-32", "gbk"]
)
def test_a_file_is_decoded_as_it_declares_or_is_marked(codec: str) -> None:
    name = "\u00e9paule" if codec != "gbk" else "\u80a9"
    text = robot(*ARM).replace("shoulder", name)
    declared = f'<?xml version="1.0" encoding="{codec.removesuffix("-sig")}"?>\n{text}'
    arm = described(declared.encode(codec), joints=(name, "elbow"))
    assert arm.joints[0] == name
    assert described(arm.urdf.text, joints=(name, "elbow")).joints[0] == name, "others get it as UTF-8"


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "arm.urdf: is empty; expected a URDF file"),
        (b"  \n", "arm.urdf: is empty"),
        (b"words", "not a readable URDF (syntax error"),
        (b"<robot", "not a readable URDF (unclosed token"),
        (b"<sdf/>", "it is <sdf>, not <robot>"),
        (b"<robot name='r'/>", "has no links"),
        (b"<!DOCTYPE html><html><body>404</body></html>", "is an HTML page"),
        (b"version https://git-lfs.github.com/spec/v1\noid", "is a pointer of Git LFS"),
        (b"<robot>\xe9</robot>", "declares no encoding, and cannot be decoded so ('utf-8' codec"),
        (b'<?xml version="1.0" encoding="klingon"?><robot/>', "declares the encoding 'klingon', and cannot"),
        (b'<?xml version="1.0" encoding="UTF-16"?><robot/>', "its first bytes are those of another"),
        (b'<?xml version="1.0" encoding="ascii"?><robot n="\xe9"/>', "declares the encoding 'ascii', and"),
        (b"\xff\xfe\x00", "declares the encoding 'utf-16', and cannot be decoded so"),
        (b"PK\x03\x04\x00\x00", "arm.urdf: "),
    ],
)  # fmt: skip
def test_what_is_no_urdf_is_refused_with_what_it_is(content: bytes, said: str) -> None:
    assert said in complaint(content)


TREE = {"links": ("base", "arm", "hand")}


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (robot(*ARM[:2], links=("base", "arm", "hand", "hand")), "link 'hand' is there twice"),
        (robot(ARM[0], ARM[0], **TREE), "joint 'shoulder' is there twice"),
        (robot(*ARM[:2], links=("base", "arm", "hand", "")), "a link has no name"),
        (robot(*ARM[:2], links=("base", "arm")), "joint 'elbow' is attached to 'hand'; expected links"),
        (robot(ARM[0], '<joint name="x" type="fixed"/>', **TREE), "joint 'x' has no <parent>"),
        (robot(ARM[0], ARM[1], joint("x", "base", "hand"), **TREE), "link 'hand' has two parents"),
        (robot(ARM[0], **TREE), "form no tree (links without a parent: base, hand)"),
        (robot(*ARM[:2], joint("x", "hand", "base"), **TREE), "form no tree (links without a parent: none)"),
        (robot(*ARM[:2], joint("a", "x", "y"), joint("b", "y", "x"), links=(*TREE["links"], "x", "y")),
         "form no tree (links without a parent: base)"),
    ],
)  # fmt: skip
def test_links_that_form_no_tree_are_refused(text: str, said: str) -> None:
    assert said in complaint(text)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('<axis xyz="0 0 1"/>', '<axis xyz="0 0 0"/>', "joint 'shoulder' has an <axis> of zeros"),
        ('<axis xyz="0 0 1"/>', '<axis xyz="0 0 nan"/>', """<axis xyz="0 0 nan">; expected 3"""),
        ('<axis xyz="0 0 1"/>', '<axis xyz="0 1"/>', """<axis xyz="0 1">; expected 3 finite numbers"""),
        ('<axis xyz="0 0 1"/>', '<axis xyz="0,0,1"/>', """<axis xyz="0,0,1">; expected 3 finite numbers"""),
        ('xyz="1 0 0"', 'xyz="${x} 0 0"', 'is a xacro file (xyz="${x} 0 0"); expected a URDF file made'),
        ('<link name="arm">', '<xacro:link name="x"/><link name="arm">', "is a xacro file (<xacro:link>)"),
        ('<link name="arm">', '<link name="$(arg x)arm">', 'is a xacro file (link name="$(arg x)arm")'),
        (LIMIT, LIMIT.replace("-1", "low"), """<limit lower="low">; expected a finite number"""),
        (LIMIT, LIMIT + '<dynamics damping="-1"/>', "joint 'shoulder' has the damping -1.0; expected"),
        (LIMIT, LIMIT + '<dynamics friction="nan"/>', '<dynamics friction="nan">; expected a finite'),
        ('type="revolute"', 'type="revolut"', "joints is 'shoulder'; expected a movable joint of the URDF"),
        ('type="revolute"', 'type="prismatic"', "joints that turn: shoulder slides, in m and N"),
        (LIMIT, LIMIT + '<mimic joint="elbow"/>', "joints that move on their own: shoulder mimics 'elbow'"),
        ('<mimic joint="slide"', '<mimic joint="elbow"', "arm.held is {}; expected {twin: POSITION} in it"),
        ('<mass value="1"/>', '<mass value="-1"/>', "link 'arm' has the mass -1.0; expected"),
        ('<mass value="1"/>', '<mass value="heavy"/>', """<inertial> has <mass value="heavy">"""),
        ('iyy="1"', 'iyy="-1"', "an <inertia> that no body has (principal moments -1, 1, 1 kg·m²)"),
        ('iyy="1"', 'iyy="9"', "an <inertia> that no body has (principal moments 1, 1, 9 kg·m²)"),
    ],
)  # fmt: skip
def test_nonsense_in_what_is_used_is_refused_by_name(old: str, new: str, said: str) -> None:
    text = robot(*ARM)
    start = text.index('<link name="arm">')  # nobody reads what the base weighs
    assert old in text[start:]
    assert said in complaint(text[:start] + text[start:].replace(old, new, 1))


def test_nonsense_in_what_nobody_uses_is_neither_refused_nor_printed(
    capfd: pytest.CaptureFixture[str],
) -> None:
    junk = (
        '<gazebo><sensor:camera a="${x}"/></gazebo><transmission/>'
        '<material name="m"><color rgba="red"/></material>'
        '<link name="camera"><visual><geometry><mesh filename="package://no/x" s="?"/></geometry></visual>'
        '<inertial><mass value="?"/></inertial></link>'
        '<joint name="mount" type="fixed"><parent link="base"/><child link="camera"/><origin xyz="?"/>'
        '<axis xyz="0 0 0"/><limit effort="?"/><mimic joint="?"/><dynamics damping="?"/></joint>'
        '<joint name="pan" type="?"><parent link="camera"/><child link="lens"/></joint>'
        '<link name="lens"/></robot>'
    )
    arm = described(robot(*ARM).replace("</robot>", junk))
    check_dynamics(arm, "hand")
    RigidBodyRegressor(plain_urdf(arm), arm.joints)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("axis", ["0 0 3", "0 0 1e-3", "0 0 1e200"])
def test_the_length_of_an_axis_matters_to_nobody(axis: str) -> None:
    text = robot(*ARM)
    right = described(text)
    other = described(text.replace('<axis xyz="0 0 1"/>', f'<axis xyz="{axis}"/>'))
    assert plain_urdf(other) == plain_urdf(right)
    q = np.array([[0.3, -0.4]])
    np.testing.assert_array_equal(
        other.chain("hand").hand_positions(q), right.chain("hand").hand_positions(q)
    )
    assert right.as_written is False is other.as_written, "the finger cannot be at 0"


def test_joints_that_do_not_move_are_held_near_0_or_where_the_configuration_says() -> None:
    assert described(robot(*ARM)).held == {"slide": 0.015, "twin": pytest.approx(0.07)}
    arm = described(robot(*ARM), held={"slide": 0.02})
    assert arm.held == {"slide": 0.02, "twin": pytest.approx(0.06)}
    assert arm.assumed == "held, as neither arm.joints nor arm.held names them: twin at 0.06"
    assert described(robot(*ARM), held={"slide": 0.02, "twin": 0.0}).assumed == ""


@pytest.mark.parametrize("leader", ["twin", "nobody"])
def test_a_joint_that_mimics_none_is_held_like_another(leader: str) -> None:
    text = robot(*ARM).replace('mimic joint="slide"', f'mimic joint="{leader}"')
    assert described(text).held["twin"] == 0.0


def test_all_readers_see_a_held_joint_at_its_place() -> None:
    # The thumb slides along z of the hand, which is 2 m out, and is 1 m further out.
    arm = described(robot(*ARM), held={"slide": 0.03})
    expected = [[3.0, 0.0, 0.04]]
    np.testing.assert_allclose(arm.chain("thumb").hand_positions(np.zeros((1, 2))), expected, atol=1e-12)
    again = described(plain_urdf(arm))
    assert again.held == {}, "fixed there"
    np.testing.assert_allclose(again.chain("thumb").hand_positions(np.zeros((1, 2))), expected, atol=1e-12)
    assert not arm.as_written


def test_a_turning_joint_is_held_at_its_angle() -> None:
    turned = joint("wrist", "hand", "finger", '<limit lower="0.5" upper="1" effort="1" velocity="1"/>')
    arm = described(robot(*ARM[:2], turned, joint("tip", "finger", "thumb", "", "fixed")))
    expected = [[3.0 + np.cos(0.5), np.sin(0.5), 0.0]]
    for each in (arm, described(plain_urdf(arm))):
        np.testing.assert_allclose(each.chain("thumb").hand_positions(np.zeros((1, 2))), expected, atol=1e-12)


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"held": {"slide": 0.5}}, "held is {'slide': 0.5}; expected 0.015 to 0.037 for slide"),
        ({"held": {"slide": float("nan")}}, "arm.held is {'slide': nan}; expected 0.015 to 0.037"),
        ({"held": {"slied": 0.02}}, "held is 'slied'; expected a joint that arm.joints does not name"),
        ({"held": {"elbow": 0.02}}, "arm.held is 'elbow'; expected a joint that arm.joints does not name"),
        ({"joints": ("elbow", "slide")}, "also 'shoulder', which carries 'elbow', or its position"),
        ({"joints": ("shoulder", "elbo")}, "(it has shoulder, elbow, slide, twin; perhaps 'elbow' is meant)"),
        ({"hand_link": "hnd"}, "arm.hand_link is 'hnd'; expected a link of the URDF (it has base, arm, hand"),
    ],
)  # fmt: skip
def test_joints_that_cannot_be_moved_or_held_so_are_refused(values: dict[str, object], said: str) -> None:
    assert said in complaint(robot(*ARM), **values)


def test_a_joint_below_the_arm_may_be_held_where_the_configuration_says() -> None:
    one = dict.fromkeys(("stiffness_nm_per_rad", "damping_nms_per_rad", "effort_limit_nm"), (1.0,))
    arm = described(robot(*ARM), joints=("elbow",), held={"shoulder": np.pi / 2}, **one)
    np.testing.assert_allclose(arm.chain("hand").hand_positions(np.zeros((1, 1))), [[1, 1, 0]], atol=1e-12)


def test_a_prefix_does_not_hide_the_joint_that_is_meant() -> None:
    text = robot(*ARM).replace("shoulder", "fer_joint1").replace("elbow", "fer_joint2")
    assert "perhaps 'fer_joint1' is meant" in complaint(text, joints=("panda_joint1", "panda_joint2"))


WITHOUT = [
    ("", "revolute"),
    ("", "continuous"),
    ('<limit effort="0" velocity="0"/>', "revolute"),
    ('<limit lower="2" upper="-1" effort="nan" velocity="-1"/>', "revolute"),
    ('<limit lower="0" upper="0" effort="inf" velocity="inf"/>', "revolute"),
    ('<limit lower="-inf" upper="nan" effort="-5"/>', "revolute"),
]
OWN = {"position_min_rad": (-0.5, -0.6), "position_max_rad": (0.7, 0.8), "velocity_limit_rad_s": (1.0, 2.0)}


@pytest.mark.parametrize(("limit", "kind"), WITHOUT)
def test_the_configurations_limits_count_where_the_file_has_none(limit: str, kind: str) -> None:
    text = robot(joint("shoulder", "base", "arm", limit, kind), *ARM[1:])
    arm = described(text, **OWN)
    filled = arm.filled(config(**OWN))
    assert {key: getattr(filled, key) for key in OWN} == OWN
    stops = (-np.inf, np.inf) if kind == "continuous" else (-0.5, 0.7)
    assert [ends[0] for ends in arm.stops_rad(filled)] == list(stops)
    RigidBodyRegressor(plain_urdf(arm), arm.joints)


@pytest.mark.parametrize(("limit", "kind"), WITHOUT)
def test_a_limit_that_neither_gives_is_refused_by_name(limit: str, kind: str) -> None:
    text = robot(joint("shoulder", "base", "arm", limit, kind), *ARM[1:])
    no_speed = {key: OWN[key] for key in ("position_min_rad", "position_max_rad")}
    assert complaint(text, **no_speed) == (
        "arm.velocity_limit_rad_s is []; expected one value for each joint: "
        "arm.urdf gives shoulder no velocity limit"
    )
    if kind == "revolute":
        said = complaint(text, velocity_limit_rad_s=(1.0, 2.0))
        assert said.startswith(
            "arm.position_min_rad is []; expected one value for each joint: arm.urdf gives shoulder no r"
        )


def test_a_part_of_the_limits_may_come_from_either() -> None:
    arm = described(robot(*ARM))
    filled = arm.filled(config(position_min_rad=(-0.5, -0.5)))
    assert (filled.position_min_rad, filled.position_max_rad) == ((-0.5, -0.5), (2.0, 2.0))
    assert filled.velocity_limit_rad_s == (3.0, 3.0)


@pytest.mark.parametrize(
    ("bodies", "said"),
    [
        ({"hand": "", "finger": "", "thumb": ""}, "joint 'elbow' moves neither mass nor inertia"),
        ({"hand": BODY.replace("1", "0"), "finger": "", "thumb": ""}, "joint 'elbow' moves neither mass"),
        ({"hand": '<inertial><mass value="1"/></inertial>', "finger": "", "thumb": ""}, "moves neither"),
    ],
)  # fmt: skip
def test_a_joint_that_nothing_resists_is_named(bodies: Mapping[str, str], said: str) -> None:
    text = robot(*ARM)
    for link, body in bodies.items():
        text = text.replace(f'<link name="{link}">{BODY}', f'<link name="{link}">{body}')
    assert said in complaint(text)


def test_a_payload_resists() -> None:
    tip = joint("tip", "hand", "thumb", "", "fixed")
    arm = described(robot(*ARM[:2], tip, links=(*TREE["links"], "thumb")).replace(BODY, ""))
    with pytest.raises(TelError, match="moves neither mass nor inertia"):
        check_dynamics(arm, "thumb")
    check_dynamics(arm, "thumb", payload_kg=0.1)


def test_a_chain_of_thousands_of_links_is_read_as_well() -> None:
    names = [f"l{k}" for k in range(3000)]
    joints = [joint(f"j{k}", *pair, "", "fixed") for k, pair in enumerate(pairwise(names))]
    arm = described(robot(*ARM, joint("more", "thumb", "l0", "", "fixed"), *joints,
                          links=("base", "arm", "hand", "finger", "thumb", *names)))  # fmt: skip
    assert len(arm.moving) == 3004


def test_moments_that_are_nearly_those_of_a_body_become_the_nearest() -> None:
    """As makers publish them, rounded or identified; PyBullet would take them as none at all."""
    arm = described(robot(*ARM).replace('iyy="1"', 'iyy="2.05"'))
    check_dynamics(arm, "hand")
    assert np.diag(inertial(arm.urdf, "arm").tensor_kgm2) == pytest.approx([1.0, 2.0, 1.0])


def test_a_plain_urdf_has_what_the_arm_carries_and_lines_that_pybullet_reads_whole() -> None:
    names = [f"l{k}" for k in range(200)]
    frames = [joint(f"j{name}", "thumb", name, "", "fixed") for name in names]
    text = robot(*ARM, *frames, joint("head", "base", "head", "", "fixed"),
                 links=(*TREE["links"], "finger", "thumb", "head", *names))  # fmt: skip
    for name in names:
        text = text.replace(f'<link name="{name}">{BODY}', f'<link name="{name}">')
    plain = plain_urdf(described(text))
    assert list(Urdf(plain.encode(), "plain").links) == ["base", "arm", "hand", "finger", "thumb"]
    assert max(map(len, plain.splitlines())) < 1024
