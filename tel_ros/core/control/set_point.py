"""What may be sent to a drive that is the spring and damper itself."""

from __future__ import annotations

import numpy as np

from tel_ros.core.arm_state import ArmState
from tel_ros.core.config import ArmConfig
from tel_ros.core.safety.rules import Permitted
from tel_ros.core.springs import Springs
from tel_ros.core.types import NS_PER_S, BoolArray, FloatArray


class SetPointGuard:
    """Keeps the equilibrium points that a position drive gets within reach of the arm, and from jumping.

    A drive that closes its own loop obeys a wrong set point with all the effort that it has. So what is
    sent (ours, not the paper's)

    - asks the springs for no more than the effort limit: u - q is at most (τ_max + B q̇) / K in the
      direction of the motion, and τ_max / K against it, where a damper that brakes with more than the
      limit is the drive's own to clip. A command whose effort is within the limits is never changed by
      this;
    - stays within the range of the joints, widened by the largest of these distances, wherever the arm says
      that it is;
    - moves no faster than ``arm.set_point_speed_rad_s``, in arm time.

    Where they disagree, the later one holds: an arm that is pushed away is followed in time. A longer time
    between two states than ``longest_gap_s`` does not allow a longer way. The empty limits of the arm must
    have been filled from the URDF.
    """

    def __init__(self, arm: ArmConfig, longest_gap_s: float) -> None:
        self._stiffness = np.array(arm.stiffness_nm_per_rad)
        self._damping = np.array(arm.damping_nms_per_rad)
        self._effort_limit = np.array(arm.effort_limit_nm)
        self._velocity_limit = np.array(arm.velocity_limit_rad_s)
        self._speed = np.array(arm.set_point_speed_rad_s or arm.velocity_limit_rad_s)
        self._longest_gap_ns = round(longest_gap_s * NS_PER_S)
        most = (self._effort_limit + self._damping * self._velocity_limit) / self._stiffness
        self._lowest = np.array(arm.position_min_rad) - most
        self._highest = np.array(arm.position_max_rad) + most
        self.last_command: FloatArray | None = None
        """The set point that was sent last; None: none so far. Shape (n_joints,)."""
        self._sent_ns = 0

    def answer(
        self, permitted: Permitted, equilibrium_rad: FloatArray, springs: Springs, state: ArmState
    ) -> tuple[FloatArray, FloatArray, BoolArray]:
        """Return the set point at which the drive exerts what is permitted, as far as :meth:`follow` lets it.

        And the effort that the drive exerts then, and where this is not what was wanted.
        """
        q, v, limit = state.position_rad, state.velocity_rad_s, self._effort_limit
        allowed_rad = springs.equilibrium(permitted.effort_nm, q, v)
        sent, held_back = self.follow(np.where(permitted.changed, allowed_rad, equilibrium_rad), state)
        effort = np.minimum(np.maximum(springs.effort(sent, q, v), -limit), limit)
        return sent, effort, permitted.changed | held_back

    def follow(self, asked_rad: FloatArray, state: ArmState) -> tuple[FloatArray, BoolArray]:
        """Return the set point to send, and for each joint whether it differs from the one asked for.

        The first one is sent as if the drive held the arm where it is; what is not finite is not followed.
        """
        q, gap_ns = state.position_rad, 0
        last = q if self.last_command is None else self.last_command
        if self.last_command is not None:
            gap_ns = min(max(state.time_ns - self._sent_ns, 0), self._longest_gap_ns)
        damping = self._damping * np.clip(state.velocity_rad_s, -self._velocity_limit, self._velocity_limit)
        low = q + (np.minimum(damping, 0.0) - self._effort_limit) / self._stiffness
        high = q + (np.maximum(damping, 0.0) + self._effort_limit) / self._stiffness
        step = self._speed * (gap_ns / NS_PER_S)
        wanted = np.where(np.isfinite(asked_rad), asked_rad, last)
        wanted = np.clip(np.clip(wanted, low, high), self._lowest, self._highest)
        sent = np.clip(wanted, last - step, last + step)
        self.last_command, self._sent_ns = sent, state.time_ns
        return sent, sent != asked_rad
