"""Where the hand is: forward kinematics of a serial arm."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tel_ros.core.types import FloatArray


@dataclass(frozen=True)
class ChainJoint:
    """One joint on the way from the base to the hand.

    Args:
        origin_m: place in the frame of the link before it. Shape (3,).
        origin_rpy_rad: orientation in it at joint position 0: roll, pitch, yaw about fixed axes. Shape (3,).
        axis: unit vector in the joint's own frame. Shape (3,).
        index: which of the arm's joints it is, or None if it does not move.
        prismatic: whether it slides along the axis [m] instead of turning about it [rad].
    """

    origin_m: FloatArray
    origin_rpy_rad: FloatArray
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
        from scipy.spatial.transform import Rotation  # late: half a second that the nodes can do without

        n = len(position_rad)
        rotation = Rotation.identity(n)
        place = np.zeros((n, 3))
        for joint in self.joints:
            place = place + rotation.apply(joint.origin_m)
            rotation = rotation * Rotation.from_euler("xyz", joint.origin_rpy_rad)
            if joint.index is None:
                continue
            along = np.outer(position_rad[:, joint.index], joint.axis)
            if joint.prismatic:
                place = place + rotation.apply(along)
            else:
                rotation = rotation * Rotation.from_rotvec(along)
        return place
