"""An arm's URDF: limits of the joints, the way to the hand, and the same arm with some of its joints held."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from urdf_parser_py.urdf import URDF

from tel_ros.core.config import ArmConfig
from tel_ros.core.errors import ConfigError, InputFileError
from tel_ros.core.kinematics import ChainJoint, LinkJoint, SerialChain
from tel_ros.core.types import FloatArray
from tel_ros.recording.shared_files import missing

MOVABLE = ("revolute", "continuous", "prismatic")
"""Types of joints that have a position."""
_STANDS_STILL_RAD = 0.01
"""Range within which a joint counts as held: its encoder may have noise."""


@dataclass(frozen=True)
class JointLimits:
    """Limits of the named joints as the URDF gives them. Arrays of length n_joints."""

    position_min_rad: tuple[float, ...]
    position_max_rad: tuple[float, ...]
    velocity_rad_s: tuple[float, ...]
    effort_nm: tuple[float, ...]
    """inf where the URDF says 0 or nothing."""

    def require_within(self, arm: ArmConfig) -> None:
        """Refuse limits of a configured arm that go beyond the URDF's.

        What the motor cannot do is clipped behind the controller's back, and learned from as if it had acted.

        Raises:
            ConfigError: an effort limit or an end of a range is beyond the URDF's.
        """
        for key, values, low, high in (
            ("effort_limit_nm", arm.effort_limit_nm, (0.0,) * len(arm.joints), self.effort_nm),
            ("position_min_rad", arm.position_min_rad, self.position_min_rad, self.position_max_rad),
            ("position_max_rad", arm.position_max_rad, self.position_min_rad, self.position_max_rad),
        ):
            for joint, value, least, most in zip(arm.joints, values, low, high, strict=True):
                if not least <= value <= most:
                    expected = f"{least:g} to {most:g} for {joint}, as in the URDF"
                    raise ConfigError(key, list(values), expected)


def read_urdf(path: Path) -> Any:
    """Return the parsed URDF; errors as :func:`parse_urdf`, or it is missing."""
    if not path.is_file():
        raise InputFileError(path, missing(path), "a URDF file (key arm.urdf)")
    try:
        content = path.read_bytes()
    except OSError as error:
        raise InputFileError(path, f"not readable ({error})", "a URDF file (key arm.urdf)") from error
    return parse_urdf(content, path)


def parse_urdf(content: bytes, path: object) -> Any:
    """Return the parsed URDF; InputFileError about ``path`` if it is none or its links form no tree."""
    try:
        urdf = URDF.from_xml_string(content)
        reached = {urdf.get_root()}
        for _ in urdf.joints:
            reached |= {joint.child for joint in urdf.joints if joint.parent in reached}
        if reached != set(urdf.link_map) or len(urdf.joints) != len(reached) - 1:
            raise ValueError("its links form no tree")
        return urdf
    except Exception as error:  # the parser raises whatever its XML library and its own checks raise
        found = f"not a readable URDF ({' '.join(str(error).split())})"
        raise InputFileError(path, found, "a URDF file (key arm.urdf)") from error


def joint_limits(urdf: Any, joints: tuple[str, ...]) -> JointLimits:
    """Return the limits of joints.

    Raises:
        ConfigError: the URDF lacks a joint, a joint cannot move or has no limits, or it is carried by a
            movable joint that is not asked for.
    """
    low, high, speed, effort = [], [], [], []
    movable = [joint.name for joint in urdf.joints if joint.type in MOVABLE]
    for name in joints:
        joint = urdf.joint_map.get(name)
        if joint is None or joint.type not in MOVABLE:
            raise ConfigError(
                "joints", name, f"a movable joint of the URDF (it has {', '.join(movable) or 'none'})"
            )
        carriers = urdf.get_chain(urdf.get_root(), joint.child, joints=True, links=False)
        for carrier in carriers:
            if urdf.joint_map[carrier].type != "fixed" and carrier not in joints:
                raise ConfigError("joints", list(joints), f"also {carrier!r}, which carries {name!r}")
        if joint.limit is None or not joint.limit.velocity:
            raise ConfigError("joints", name, "a joint with a velocity limit in the URDF")
        continuous = joint.type == "continuous"
        low.append(-1e6 if continuous else float(joint.limit.lower or 0.0))
        high.append(1e6 if continuous else float(joint.limit.upper or 0.0))
        speed.append(float(joint.limit.velocity))
        effort.append(float(joint.limit.effort or math.inf))
    return JointLimits(tuple(low), tuple(high), tuple(speed), tuple(effort))


def chain_to_hand(urdf: Any, joints: tuple[str, ...], hand_link: str) -> SerialChain:
    """Return the chain of joints from the URDF's root to the hand; ConfigError if there is no such link."""
    if hand_link not in urdf.link_map:
        links = ", ".join(urdf.link_map)
        raise ConfigError("hand_link", hand_link, f"a link of the URDF (it has {links})")
    names = urdf.get_chain(urdf.get_root(), hand_link, joints=True, links=False)
    return SerialChain(tuple(_chain_joint(urdf.joint_map[name], joints) for name in names))


def link_joints(urdf: Any, joints: tuple[str, ...]) -> tuple[LinkJoint, ...]:
    """Return all joints of the URDF, in its order; those that are not among ``joints`` stay at 0."""
    return tuple(LinkJoint(each.parent, each.child, _chain_joint(each, joints)) for each in urdf.joints)


def _chain_joint(joint: Any, joints: tuple[str, ...]) -> ChainJoint:
    axis = np.array(joint.axis if joint.axis is not None else [1.0, 0.0, 0.0], dtype=float)
    nowhere = [0.0, 0.0, 0.0]
    return ChainJoint(
        origin_m=np.array((joint.origin and joint.origin.xyz) or nowhere, dtype=float),
        origin_rpy_rad=np.array((joint.origin and joint.origin.rpy) or nowhere, dtype=float),
        axis=axis / np.linalg.norm(axis) if np.any(axis) else axis,
        index=joints.index(joint.name) if joint.name in joints else None,
        prismatic=joint.type == "prismatic",
    )


def arm_description(
    file: Path, joints: Sequence[str], others: Mapping[str, tuple[float, float]]
) -> tuple[str, list[str]]:
    """Return a URDF in which all joints that are not learned are fixed where they were.

    Args:
        file: URDF of the arm.
        joints: that are learned.
        others: within which positions [rad] other joints were recorded; what was not is taken to be at 0.

    Returns:
        Its text, and what had to be assumed, in words.

    Raises:
        InputFileError: the file is missing, or no URDF.
        ConfigError: a joint is not in it, or one that is not learned has moved.
    """
    urdf = read_urdf(file)
    movable = [joint.name for joint in urdf.joints if joint.type in MOVABLE]
    missing = [joint for joint in joints if joint not in movable]
    if missing:
        expected = f"movable joints of {file} (it has {', '.join(movable) or 'none'})"
        raise ConfigError("joints", ", ".join(missing), expected)
    robot = ElementTree.fromstring(file.read_bytes())
    assumed = []
    for element in robot.iterfind("joint"):
        name = element.get("name", "")
        if name not in movable or name in joints:
            continue
        low, high = others.get(name, (0.0, 0.0))
        if high - low > _STANDS_STILL_RAD:
            expected = f"also {name}, which moved by {high - low:.3g} rad in the recording"
            raise ConfigError("joints", ", ".join(joints), expected)
        if name not in others:
            assumed.append(f"{name} was not recorded: the arm is described with it at 0")
        _fix(element, 0.5 * (low + high))
    return ElementTree.tostring(robot, encoding="unicode"), assumed


def _fix(element: ElementTree.Element, position: float) -> None:
    """Turn a movable joint into a fixed one at a position, in rad or m."""
    from scipy.spatial.transform import Rotation  # late: half a second that the nodes can do without

    origin = element.find("origin")
    if origin is None:
        origin = ElementTree.SubElement(element, "origin")
    axis_element = element.find("axis")
    axis = _numbers("1 0 0" if axis_element is None else axis_element.get("xyz", "1 0 0"))
    along = position * axis / np.linalg.norm(axis)
    rotation = Rotation.from_euler("xyz", _numbers(origin.get("rpy", "0 0 0")))
    if element.get("type") == "prismatic":
        place = _numbers(origin.get("xyz", "0 0 0")) + rotation.apply(along)
        origin.set("xyz", " ".join(map(repr, place.tolist())))
    else:
        turned = (rotation * Rotation.from_rotvec(along)).as_euler("xyz")
        origin.set("rpy", " ".join(map(repr, turned.tolist())))
    element.set("type", "fixed")
    for tag in ("axis", "limit", "dynamics", "mimic", "safety_controller", "calibration"):
        for child in element.findall(tag):
            element.remove(child)


def _numbers(text: str) -> FloatArray:
    return np.array(text.split(), dtype=np.float64)
