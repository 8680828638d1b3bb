"""What an arm's URDF says about its joints: limits and the way to the hand."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation
from urdf_parser_py.urdf import URDF

from tel_ros.core.errors import ConfigError, InputFileError
from tel_ros.core.kinematics import ChainJoint, SerialChain
from tel_ros.core.types import FloatArray

_MOVABLE = ("revolute", "continuous", "prismatic")


@dataclass(frozen=True)
class JointLimits:
    """Limits of the named joints as the URDF gives them. Arrays of length n_joints."""

    position_min_rad: tuple[float, ...]
    position_max_rad: tuple[float, ...]
    velocity_rad_s: tuple[float, ...]


def read_urdf(path: Path) -> Any:
    """Return the parsed URDF.

    Raises:
        InputFileError: it is missing, is no URDF, or its links form no tree.
    """
    if not path.is_file():
        raise InputFileError(path, "there is no such file", "a URDF file (key arm.urdf)")
    try:
        urdf = URDF.from_xml_string(path.read_bytes())
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
        ConfigError: the URDF lacks a joint, or a joint cannot move or has no limits.
    """
    low, high, speed = [], [], []
    movable = [joint.name for joint in urdf.joints if joint.type in _MOVABLE]
    for name in joints:
        joint = urdf.joint_map.get(name)
        if joint is None or joint.type not in _MOVABLE:
            raise ConfigError(
                "joints", name, f"a movable joint of the URDF (it has {', '.join(movable) or 'none'})"
            )
        if joint.limit is None or not joint.limit.velocity:
            raise ConfigError("joints", name, "a joint with a velocity limit in the URDF")
        continuous = joint.type == "continuous"
        low.append(-1e6 if continuous else float(joint.limit.lower or 0.0))
        high.append(1e6 if continuous else float(joint.limit.upper or 0.0))
        speed.append(float(joint.limit.velocity))
    return JointLimits(tuple(low), tuple(high), tuple(speed))


def _pose(origin: Any) -> FloatArray:
    pose = np.eye(4)
    if origin is not None:
        pose[:3, :3] = Rotation.from_euler("xyz", origin.rpy or [0.0, 0.0, 0.0]).as_matrix()
        pose[:3, 3] = origin.xyz or [0.0, 0.0, 0.0]
    return pose


def chain_to_hand(urdf: Any, joints: tuple[str, ...], hand_link: str) -> SerialChain:
    """Return the chain of joints from the root of the URDF to the hand.

    Raises:
        ConfigError: the URDF has no such link.
    """
    if hand_link not in urdf.link_map:
        links = ", ".join(urdf.link_map)
        raise ConfigError("hand_link", hand_link, f"a link of the URDF (it has {links})")
    names = urdf.get_chain(urdf.get_root(), hand_link, joints=True, links=False)
    chain = []
    for joint in (urdf.joint_map[name] for name in names):
        axis = np.array(joint.axis if joint.axis is not None else [1.0, 0.0, 0.0], dtype=float)
        chain.append(
            ChainJoint(
                origin=_pose(joint.origin),
                axis=axis / np.linalg.norm(axis) if np.any(axis) else axis,
                index=joints.index(joint.name) if joint.name in joints else None,
                prismatic=joint.type == "prismatic",
            )
        )
    return SerialChain(tuple(chain))
