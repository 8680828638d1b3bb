"""Equilibrium-point control: a virtual spring and damper at every joint."""

from __future__ import annotations

from dataclasses import dataclass

from tel_ros.core.types import FloatArray


@dataclass(frozen=True)
class EpLaw:
    """The control law τ = K (u - q) - B q̇ ([Practice] Sec. 3; Shadmehr 1990).

    What it wants is not yet what may reach the arm: :class:`~tel_ros.core.safety.layer.SafetyLayer`.

    Args:
        stiffness_nm_per_rad: K, one positive number a joint. Shape (n_joints,).
        damping_nms_per_rad: B, likewise.
    """

    stiffness_nm_per_rad: FloatArray
    damping_nms_per_rad: FloatArray

    def effort(
        self, equilibrium_rad: FloatArray, position_rad: FloatArray, velocity_rad_s: FloatArray
    ) -> FloatArray:
        """Return the effort [N·m] that the springs and dampers want. Shapes (n_joints,)."""
        wanted: FloatArray = (
            self.stiffness_nm_per_rad * (equilibrium_rad - position_rad)
            - self.damping_nms_per_rad * velocity_rad_s
        )
        return wanted

    def equilibrium(
        self, effort_nm: FloatArray, position_rad: FloatArray, velocity_rad_s: FloatArray
    ) -> FloatArray:
        """Return the equilibrium points [rad] at which they want an effort. Shapes (n_joints,)."""
        wanted: FloatArray = (
            position_rad + (effort_nm + self.damping_nms_per_rad * velocity_rad_s) / self.stiffness_nm_per_rad
        )
        return wanted
