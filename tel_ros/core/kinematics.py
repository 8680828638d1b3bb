"""Where the hand is: forward kinematics of a serial arm."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tel_ros.core.types import FloatArray


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

    def placements(self, position_rad: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return where the link behind the joint is in the frame of the link before it.

        For joint positions [rad, m] of shape (n, n_joints): places [m] of shape (n, 3), and rotation matrices
        of shape (n, 3, 3).
        """
        n = len(position_rad)
        places, origin = np.tile(self.origin_m, (n, 1)), np.eye(3)
        for unit, angle_rad in zip(np.eye(3), self.origin_rpy_rad, strict=True):
            origin = _turns(unit, angle_rad[np.newaxis])[0] @ origin
        moved = np.zeros(n) if self.index is None else position_rad[:, self.index]
        if self.prismatic:
            places = places + np.outer(moved, origin @ self.axis)
            moved = np.zeros(n)
        return places, origin @ _turns(self.axis, moved)


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
        place, turn = np.zeros((len(position_rad), 3)), np.eye(3)
        for joint in self.joints:
            placed, turned = joint.placements(position_rad)
            place, turn = place + (turn @ placed[..., np.newaxis])[..., 0], turn @ turned
        return place


def _turns(axis: FloatArray, angle_rad: FloatArray) -> FloatArray:
    """Return the matrices of rotations about a unit vector, shape (n, 3, 3), by Rodrigues' formula.

    SciPy's rotations would cost every node a third of a second when it starts.
    """
    cross = np.cross(np.eye(3), axis)
    sine, cosine = (function(angle_rad)[:, np.newaxis, np.newaxis] for function in (np.sin, np.cos))
    return np.eye(3) + sine * cross + (1.0 - cosine) * (cross @ cross)
