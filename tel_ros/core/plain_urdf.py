"""The bodies of an arm: whether they can be simulated, and a URDF of them that nobody can misunderstand."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Sequence
from typing import NamedTuple
from xml.etree.ElementTree import Element, SubElement, indent, tostring

import numpy as np

from tel_ros.core.arm_description import ArmDescription, listed
from tel_ros.core.config import JointValues
from tel_ros.core.errors import InputFileError
from tel_ros.core.kinematics import ChainJoint
from tel_ros.core.types import FloatArray
from tel_ros.core.urdf import NOWHERE, Joint, Urdf

PAYLOAD_LINK = "tel_ros_payload"
MOST_LINKS = 127
_ROUNDING, _NEARLY = 1e-9, 1.3
"""How far a moment of inertia may be above the sum of the two others: by rounding, and at all."""
_NOTHING_KGM2 = 1e-12
_BENT_RAD = 0.5
"""Of every joint: stretched out, at 0, an arm may not feel a point mass at its hand."""
_MOMENTS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")


class Inertial(NamedTuple):
    """Mass, its centre, and the moments of inertia about that in a frame turned by ``rpy_rad``."""

    mass_kg: float = 0.0
    centre_m: tuple[float, ...] = NOWHERE
    rpy_rad: tuple[float, ...] = NOWHERE
    moments_kgm2: tuple[float, ...] = (0.0,) * len(_MOMENTS)

    @property
    def tensor_kgm2(self) -> FloatArray:
        """The moments as a matrix, shape (3, 3)."""
        xx, xy, xz, yy, yz, zz = self.moments_kgm2
        return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def inertial(urdf: Urdf, link: str, *, strict: bool = False) -> Inertial:
    """Return the inertial of a link; zero if it has none or, unless ``strict``, one that is nonsense.

    Moments of which one is a bit above the sum of the two others, as it happens by rounding, become the
    nearest that a body can have, and those next to nothing 0: PyBullet would take them all as 0.
    """
    try:
        found = _written(urdf, link)
    except InputFileError as error:
        if not strict:
            return Inertial()
        raise urdf.refused(f"link {link!r}: {error.found}", error.expected) from None
    moments, axes = np.linalg.eigh(found.tensor_kgm2)
    most = moments[0] + moments[1]
    if abs(moments).max() < _NOTHING_KGM2:
        return found._replace(moments_kgm2=(0.0,) * len(_MOMENTS))
    if not most < moments[2] <= _NEARLY * most:
        return found
    tensor = axes @ np.diag([*moments[:2], (1.0 - _ROUNDING) * most]) @ axes.T
    return found._replace(moments_kgm2=tuple(tensor[np.triu_indices(3)].tolist()))


def _written(urdf: Urdf, link: str) -> Inertial:
    element, read = urdf.links[link].find("inertial"), urdf.numbers
    if element is None:
        return Inertial()
    return Inertial(
        read(element, "mass", "value", (0.0,))[0],
        read(element, "origin", "xyz", NOWHERE),
        read(element, "origin", "rpy", NOWHERE),
        tuple(read(element, "inertia", key, (0.0,))[0] for key in _MOMENTS),
    )


def remarks(arm: ArmDescription) -> tuple[str, ...]:
    """Return what the file says, or leaves out, that its author may not have meant: one sentence each."""
    links = {name: link for name, link in arm.urdf.links.items() if name in arm.moving}
    found = {name: inertial(arm.urdf, name, strict=True) for name in links}
    with_shape = [k for k, link in links.items() if link.findall("visual") + link.findall("collision")]
    bare = [name for name in with_shape if links[name].find("inertial") is None]
    massless = [name for name, each in found.items() if not each.mass_kg and any(each.moments_kgm2)]
    changed = [name for name, each in found.items() if each != _written(arm.urdf, name)]
    said = {
        "links with a shape, but no <inertial>, are taken as weightless": bare,
        "links with an <inertia>, but no mass, are taken as written": massless,
        "links with an <inertia> that hardly a body has are given the nearest that one can have": changed,
    }
    return tuple(f"{what}: {listed(names)}" for what, names in said.items() if names)


def plain_urdf(
    arm: ArmDescription,
    *,
    inertia_scale: float = 1.0,
    payload_kg: float = 0.0,
    hand_link: str = "",
    stops_rad: tuple[JointValues, JointValues] | None = None,
    mesh: Callable[[str], str | None] | None = None,
) -> str:
    """Return a URDF with nothing in it but the bodies and joints of an arm, of which only its own move.

    What it does not carry is left out, unless it is to be seen. A link without ``<inertial>`` has no mass, as
    the format means it (PyBullet would give it 1 kg). ``inertia_scale``: factor on the masses and inertias of
    the links, not on the payload. ``payload_kg``: point mass at the origin of the hand link. ``hand_link``:
    the link that carries it. ``stops_rad``: between which positions the joints move, instead of what the file
    says; a joint that turns without end does not, if they are finite. ``mesh``: from the name of a mesh to
    its file, or None if it is missing; None: without shapes.
    """
    robot, urdf = Element("robot", name="arm"), arm.urdf
    robot.extend(urdf.materials if mesh else ())
    kept = set(urdf.links) if mesh else _needed(arm, hand_link)
    for name, link in ((name, link) for name, link in urdf.links.items() if name in kept):
        body = SubElement(robot, "link", name=name)
        _add_inertial(body, inertial(urdf, name), inertia_scale)
        for visual in copy.deepcopy(link.findall("visual")) if mesh else ():
            meshes = list(visual.iter("mesh"))
            files = [mesh(each.get("filename", "")) if mesh else None for each in meshes]
            for each, file in zip(meshes, files, strict=True):
                each.set("filename", file or "")
            body.extend([visual] if all(files) else [])
    for joint in (joint for joint in urdf.joints.values() if joint.child in kept):
        _add_joint(robot, joint, arm.placed[joint.name], arm, stops_rad)
    if payload_kg:
        _add_inertial(SubElement(robot, "link", name=PAYLOAD_LINK), Inertial(payload_kg), 1.0)
        mount = SubElement(robot, "joint", name=f"{PAYLOAD_LINK}_mount", type="fixed")
        SubElement(mount, "parent", link=hand_link)
        SubElement(mount, "child", link=PAYLOAD_LINK)
    indent(robot)  # PyBullet loses characters of lines that are longer than 1024
    return tostring(robot, encoding="unicode")


def _needed(arm: ArmDescription, hand_link: str) -> set[str]:
    """Return the links without which the arm would be another one."""
    urdf = arm.urdf
    ends = {urdf.joints[name].child for name in arm.joints}
    ends |= {hand_link} if hand_link else set()
    ways = {joint.child for link in arm.moving | ends for joint in urdf.way_to(link)}
    kept = [link for link in urdf.below(urdf.root) if link in ways or link == urdf.root]
    # PyBullet does not tell the state of joints beyond its 127th: leave out frames on which nothing depends.
    for link in kept[::-1] if len(kept) > MOST_LINKS else ():
        carries = any(joint.child in kept for joint in urdf.carried[link])
        if (
            not carries
            and link not in ends
            and not any((inertial(urdf, link).mass_kg, *inertial(urdf, link).moments_kgm2))
        ):
            kept.remove(link)
    return set(kept)


def check_dynamics(
    arm: ArmDescription, hand_link: str, payload_kg: float = 0.0, position_rad: FloatArray | None = None
) -> FloatArray:
    """Return the inertia matrix at a posture [kg·m²]; refuse what cannot be simulated.

    That is bodies that cannot exist, and joints that nothing resists. Raises InputFileError: a link that
    moves has a negative mass or moment, or a moment above the sum of the two others, which PyBullet would
    silently take as no inertia at all; or the inertia matrix of the arm is not positive definite.
    """
    n = len(arm.joints)
    posture, inertia = np.full((1, n), _BENT_RAD), np.zeros((n, n))
    if position_rad is not None:
        posture[0] = position_rad
    frames = {arm.urdf.root: (np.zeros(3), np.eye(3))}
    screws: dict[str, dict[int, tuple[FloatArray, FloatArray]]] = {arm.urdf.root: {}}
    for link in arm.urdf.below(arm.urdf.root):
        place, turn = frames[link]
        for joint in arm.urdf.carried[link]:
            placed = arm.placed[joint.name]
            shift, turned = placed.placements(posture)
            there = frames[joint.child] = (place + turn @ shift[0], turn @ turned[0])
            own = {} if placed.index is None else {placed.index: (there[1] @ placed.axis, there[0])}
            screws[joint.child] = screws[link] | own
        if link not in arm.moving:
            continue
        body = inertial(arm.urdf, link, strict=True)
        _check_body(arm.urdf, link, body)
        for each in (body, Inertial(payload_kg)) if link == hand_link else (body,):
            # The frame of the moments, as a joint that does not move.
            still = ChainJoint(np.array(each.centre_m), np.array(each.rpy_rad), np.zeros(3), None)
            shift, turned = still.placements(posture)
            centre, axes = place + turn @ shift[0], turn @ turned[0]
            tensor = axes @ each.tensor_kgm2 @ axes.T
            ways = [(k, axis, np.cross(axis, centre - at)) for k, (axis, at) in screws[link].items()]
            for i, axis, way in ways:
                for j, other, other_way in ways:
                    inertia[i, j] += each.mass_kg * way @ other_way + axis @ tensor @ other
    idle = [name for name, value in zip(arm.joints, np.diag(inertia), strict=True) if not value > 0.0]
    if idle or not np.all(np.linalg.eigvalsh(inertia) > 1e-12 * np.trace(inertia)):
        found = f"joint {idle[0]!r} moves" if idle else "it has a joint that moves"
        expected = "an <inertial> with mass in the links that move"
        raise arm.urdf.refused(f"{found} neither mass nor inertia", expected)
    return inertia


def _check_body(urdf: Urdf, link: str, body: Inertial) -> None:
    if body.mass_kg < 0.0:
        raise urdf.refused(f"link {link!r} has the mass {body.mass_kg}", "a number of kg of at least 0")
    moments = np.linalg.eigvalsh(body.tensor_kgm2)
    rounding = _ROUNDING * abs(moments).max()
    if not (moments[0] >= -rounding and moments[2] <= moments[0] + moments[1] + rounding):
        found = ", ".join(f"{moment:.4g}" for moment in moments)
        raise urdf.refused(
            f"link {link!r} has an <inertia> that no body has (principal moments {found} kg·m²)",
            "principal moments of at least 0, none above the sum of the two others",
        )


def _add_joint(
    robot: Element,
    joint: Joint,
    placed: ChainJoint,
    arm: ArmDescription,
    stops_rad: tuple[JointValues, JointValues] | None,
) -> None:
    index = placed.index
    kind = "fixed" if index is None else joint.kind
    if kind == "continuous" and stops_rad and math.isfinite(stops_rad[0][index or 0]):
        kind = "revolute"
    element = SubElement(robot, "joint", name=joint.name, type=kind)
    SubElement(element, "origin", xyz=_joined(placed.origin_m), rpy=_joined(placed.origin_rpy_rad))
    SubElement(element, "parent", link=joint.parent)
    SubElement(element, "child", link=joint.child)
    if index is None:
        return
    SubElement(element, "axis", xyz=_joined(placed.axis))
    limit = arm.limits[index]
    low, high = limit.range_rad or (-math.inf, math.inf)
    if stops_rad is not None:
        low, high = stops_rad[0][index], stops_rad[1][index]
    values = {"lower": low, "upper": high, "effort": limit.effort_nm, "velocity": limit.velocity_rad_s}
    given = {key: repr(value) for key, value in values.items() if math.isfinite(value)}
    if given or kind != "continuous":
        SubElement(element, "limit", {"effort": "0.0", "velocity": "0.0"} | given)


def _add_inertial(body: Element, each: Inertial, scale: float) -> None:
    element = SubElement(body, "inertial")
    SubElement(element, "origin", xyz=_joined(each.centre_m), rpy=_joined(each.rpy_rad))
    SubElement(element, "mass", value=repr(each.mass_kg * scale))
    moments = zip(_MOMENTS, each.moments_kgm2, strict=True)
    SubElement(element, "inertia", {key: repr(value * scale) for key, value in moments})


def _joined(values: Sequence[float] | FloatArray) -> str:
    return " ".join(repr(float(value)) for value in values)
