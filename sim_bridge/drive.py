"""A position drive: the spring and the damper inside the arm's motor controllers."""

from __future__ import annotations

from dataclasses import dataclass

from tel_ros.core.config import JointValues


@dataclass(frozen=True)
class PositionDrive:
    """The control law τ = K (u - q) - B q̇ with |τ| limited, as a drive evaluates it at its own, high rate.

    Its position and velocity are the true ones: what a drive's own encoder and its rate make of them is
    finer than what the joint states tell.

    Args:
        stiffness_nm_per_rad: K, one value a joint.
        damping_nms_per_rad: B, likewise.
        effort_limit_nm: likewise.
    """

    stiffness_nm_per_rad: JointValues
    damping_nms_per_rad: JointValues
    effort_limit_nm: JointValues

    def effort_nm(
        self, set_point_rad: JointValues, position_rad: JointValues, velocity_rad_s: JointValues
    ) -> JointValues:
        """Return the torque of each motor at a state, for a set point u."""
        return tuple(
            max(-limit, min(limit, k * (u - q) - b * v))
            for k, b, limit, u, q, v in zip(
                self.stiffness_nm_per_rad,
                self.damping_nms_per_rad,
                self.effort_limit_nm,
                set_point_rad,
                position_rad,
                velocity_rad_s,
                strict=True,
            )
        )
