"""Where the hand is: forward kinematics of a serial arm."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from tel_ros.core.types import FloatArray


@dataclass(frozen=True)
class ChainJoint:
    """One joint on the way from the base to the hand.

    Args:
        origin: pose in the frame of the link before it, at joint position 0. Shape (4, 4).
        axis: unit vector in the joint's own frame. Shape (3,).
        index: which of the arm's joints it is, or None if it does not move.
        prismatic: whether it slides along the axis [m] instead of turning about it [rad].
    """

    origin: FloatArray
    axis: FloatArray
    index: int | None
    prismatic: bool = False


@dataclass(frozen=True)
class SerialChain:
    """The joints from the base to the hand, in order."""

    joints: tuple[ChainJoint, ...]

    def hand_positions(self, position_rad: FloatArray) -> FloatArray:
        """Return the hand's position [m] in the base frame for joint positions of shape (n, n_joints).

        Returns:
            Shape (n, 3).
        """
        n = len(position_rad)
        rotation = Rotation.identity(n)
        place = np.zeros((n, 3))
        for joint in self.joints:
            place = place + rotation.apply(joint.origin[:3, 3])
            rotation = rotation * Rotation.from_matrix(joint.origin[:3, :3])
            if joint.index is None:
                continue
            along = np.outer(position_rad[:, joint.index], joint.axis)
            if joint.prismatic:
                place = place + rotation.apply(along)
            else:
                rotation = rotation * Rotation.from_rotvec(along)
        return place
