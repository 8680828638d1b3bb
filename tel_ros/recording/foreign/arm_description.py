"""The URDF of an arm of which some joints were recorded, and others held."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from tel_ros.core.errors import ConfigError
from tel_ros.core.types import FloatArray
from tel_ros.recording.urdf import MOVABLE, read_urdf

_STANDS_STILL_RAD = 0.01
"""Range within which a joint counts as held: its encoder may have noise."""


def arm_description(
    file: Path, joints: Sequence[str], others: Mapping[str, tuple[float, float]]
) -> tuple[str, list[str]]:
    """Return a URDF in which all joints that are not learned are fixed where they were.

    Args:
        file: URDF of the arm.
        joints: that are learned.
        others: within which positions [rad] other joints were recorded. What was not recorded is taken to
            have been at zero.

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
    origin = element.find("origin")
    if origin is None:
        origin = ElementTree.SubElement(element, "origin")
    axis_element = element.find("axis")
    axis = _triple("1 0 0" if axis_element is None else axis_element.get("xyz", "1 0 0"))
    along = position * axis / np.linalg.norm(axis)
    rotation = Rotation.from_euler("xyz", _triple(origin.get("rpy", "0 0 0")))
    if element.get("type") == "prismatic":
        place = _triple(origin.get("xyz", "0 0 0")) + rotation.apply(along)
        origin.set("xyz", " ".join(map(repr, place.tolist())))
    else:
        turned = (rotation * Rotation.from_rotvec(along)).as_euler("xyz")
        origin.set("rpy", " ".join(map(repr, turned.tolist())))
    element.set("type", "fixed")
    for tag in ("axis", "limit", "dynamics", "mimic", "safety_controller", "calibration"):
        for child in element.findall(tag):
            element.remove(child)


def _triple(text: str) -> FloatArray:
    return np.array(text.split(), dtype=np.float64)
