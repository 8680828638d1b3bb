"""Equilibrium-point control: a virtual spring and damper at every joint."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tel_ros.core.types import BoolArray, FloatArray


@dataclass(frozen=True)
class EpLaw:
    """The control law τ = K (u - q) - B q̇ with |τ| limited ([Practice] Sec. 3; Shadmehr 1990).

    Args:
        stiffness_nm_per_rad: K, one positive number a joint. Shape (n_joints,).
        damping_nms_per_rad: B, likewise.
        effort_limit_nm: what the command is clipped to, likewise.
    """

    stiffness_nm_per_rad: FloatArray
    damping_nms_per_rad: FloatArray
    effort_limit_nm: FloatArray

    def effort(
        self, equilibrium_rad: FloatArray, position_rad: FloatArray, velocity_rad_s: FloatArray
    ) -> tuple[FloatArray, BoolArray]:
        """Return the effort [N·m] and for each joint whether the limit changed it. Shapes (n_joints,)."""
        wanted = (
            self.stiffness_nm_per_rad * (equilibrium_rad - position_rad)
            - self.damping_nms_per_rad * velocity_rad_s
        )
        clipped = np.minimum(np.maximum(wanted, -self.effort_limit_nm), self.effort_limit_nm)
        return clipped, clipped != wanted
