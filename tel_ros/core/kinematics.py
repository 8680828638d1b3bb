"""Where the hand is: forward kinematics of a serial arm."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from tel_ros.core.types import FloatArray

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation


@dataclass(frozen=True)
class ChainJoint:
    """One joint on the way from the base to the hand. Vectors of shape (3,)."""

    origin_m: FloatArray
    """Place in the frame of the link before it."""
    origin_rpy_rad: FloatArray
    """Orientation in it at joint position 0: roll, pitch, yaw about fixed axes."""
    axis: FloatArray
    """Unit vector in the joint's own frame."""
    index: int | None
    """Which of the arm's joints it is, or None if it does not move."""
    prismatic: bool = False
    """Whether it slides along the axis [m] instead of turning about it [rad]."""

    def placements(self, position_rad: FloatArray) -> tuple[FloatArray, Rotation]:
        """Return where the link behind the joint is in the frame of the link before it.

        For joint positions [rad, m] of shape (n, n_joints): places [m] of shape (n, 3), and n orientations.
        """
        from scipy.spatial.transform import Rotation  # late: half a second that the nodes can do without

        n = len(position_rad)
        origin = Rotation.from_euler("xyz", self.origin_rpy_rad)
        places = np.tile(self.origin_m, (n, 1))
        if self.index is None:
            return places, origin * Rotation.identity(n)
        along = np.outer(position_rad[:, self.index], self.axis)
        if self.prismatic:
            return places + origin.apply(along), origin * Rotation.identity(n)
        return places, origin * Rotation.from_rotvec(along)


@dataclass(frozen=True)
class LinkJoint:
    """A joint of a tree of links: how the child is placed in the frame of its parent."""

    parent: str
    child: str
    joint: ChainJoint


@dataclass(frozen=True)
class SerialChain:
    """The joints from the base to the hand, in order."""

    joints: tuple[ChainJoint, ...]

    def hand_positions(self, position_rad: FloatArray) -> FloatArray:
        """Return the hand's positions [m] in the base frame, shape (n, 3), for positions (n, n_joints)."""
        from scipy.spatial.transform import Rotation  # late: half a second that the nodes can do without

        n = len(position_rad)
        rotation = Rotation.identity(n)
        place = np.zeros((n, 3))
        for joint in self.joints:
            placed, turned = joint.placements(position_rad)
            place = place + rotation.apply(placed)
            rotation = rotation * turned
        return place
