"""Equilibrium-point control: a virtual spring and damper at every joint, and what it takes to change them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tel_ros.core.arm_state import ArmState
from tel_ros.core.config import ArmConfig
from tel_ros.core.errors import TrajectoryError
from tel_ros.core.types import FloatArray


@dataclass(frozen=True)
class Springs:
    """K and B at all joints; the control law is τ = K (u - q) - B q̇ ([Practice] Sec. 3; Shadmehr 1990).

    What it wants is not yet what may reach the arm: :class:`~tel_ros.core.safety.layer.SafetyLayer`. K and B
    have the shape (n_joints,), positions, velocities and efforts (n_joints,) or (n, n_joints). Raises
    TrajectoryError: the shapes differ, or a value is not finite, K is not above 0, or B is below 0.
    """

    stiffness_nm_per_rad: FloatArray
    damping_nms_per_rad: FloatArray

    def __post_init__(self) -> None:
        k, b = self.stiffness_nm_per_rad, self.damping_nms_per_rad
        if k.ndim != 1 or k.shape != b.shape:
            raise TrajectoryError(
                f"stiffness and damping have shapes {k.shape} and {b.shape}; expected one value a joint"
            )
        # Written so that NaN fails.
        if not (np.all((k > 0.0) & (k < math.inf)) and np.all((b >= 0.0) & (b < math.inf))):
            raise TrajectoryError(
                f"stiffness is {k.tolist()} N·m/rad and damping {b.tolist()} N·m·s/rad; expected finite "
                "numbers, stiffness above 0 and damping of at least 0"
            )

    @classmethod
    def of(cls, arm: ArmConfig) -> Springs:
        """Return the springs of a configured arm."""
        return cls(np.array(arm.stiffness_nm_per_rad), np.array(arm.damping_nms_per_rad))

    def equal(self, other: Springs) -> bool:
        """Return whether K and B are the same to the last bit."""
        return all(np.array_equal(value, getattr(other, name)) for name, value in vars(self).items())

    def scaled(self, factor: float) -> Springs:
        """Return springs with ``factor`` times K. B goes with its root, which keeps the damping ratio."""
        return Springs(factor * self.stiffness_nm_per_rad, math.sqrt(factor) * self.damping_nms_per_rad)

    def require_within(self, factor: float, configured: Springs) -> None:
        """Refuse springs that are much stiffer or softer than the configured ones.

        Stiffer ones need a faster control loop; with softer ones, a given effort takes an equilibrium point
        that is further away. Raises TrajectoryError: another number of joints, or a K or B beyond ``factor``
        times the configured one or below its ``factor``-th part.
        """
        for name, found, reference, unit in (
            ("stiffness", self.stiffness_nm_per_rad, configured.stiffness_nm_per_rad, "N·m/rad"),
            ("damping", self.damping_nms_per_rad, configured.damping_nms_per_rad, "N·m·s/rad"),
        ):
            low, high = reference / factor, reference * factor
            # The margin is for rounding: the bound itself may be asked for.
            least, most = low * (1.0 - 1e-9), high * (1.0 + 1e-9)
            if found.shape != reference.shape or not np.all((found >= least) & (found <= most)):
                expected = f"expected {low.tolist()} to {high.tolist()}"
                raise TrajectoryError(f"{name} is {found.tolist()} {unit}; {expected}")

    def effort(
        self, equilibrium_rad: FloatArray, position_rad: FloatArray, velocity_rad_s: FloatArray
    ) -> FloatArray:
        """Return the effort in N·m."""
        k, b = self.stiffness_nm_per_rad, self.damping_nms_per_rad
        return k * (equilibrium_rad - position_rad) - b * velocity_rad_s

    def pull(self, wanted_rad: FloatArray, state: ArmState) -> Callable[[int], float]:
        """Return how hard the spring of a joint, by its number, pulls to a position in N·m, if asked."""
        stiffness, positions = self.stiffness_nm_per_rad, state.positions
        return lambda j: float(stiffness[j] * (wanted_rad[j] - positions[j]))

    def equilibrium(
        self, effort_nm: FloatArray, position_rad: FloatArray, velocity_rad_s: FloatArray
    ) -> FloatArray:
        """Return the equilibrium points in rad for an effort."""
        k, b = self.stiffness_nm_per_rad, self.damping_nms_per_rad
        return position_rad + (effort_nm + b * velocity_rad_s) / k

    def equilibrium_for(
        self,
        other: Springs,
        equilibrium_rad: FloatArray,
        position_rad: FloatArray,
        velocity_rad_s: FloatArray,
    ) -> FloatArray:
        """Return where to pull to for the effort that other springs exert, which pull to ``equilibrium_rad``.

        K (u - q) - B q̇ = K' (u' - q) - B' q̇. Equal springs give back the same array.
        """
        if self.equal(other):
            return equilibrium_rad
        effort_nm = other.effort(equilibrium_rad, position_rad, velocity_rad_s)
        return self.equilibrium(effort_nm, position_rad, velocity_rad_s)


@dataclass(frozen=True)
class SpringChange:
    """The springs that a trial used, where they are not the configured ones, which learners learn for."""

    used: Springs
    configured: Springs

    def learned(
        self, equilibrium_rad: FloatArray, position_rad: FloatArray, velocity_rad_s: FloatArray
    ) -> FloatArray:
        """Return the û of the configured springs that would have exerted the same. Shapes (n, n_joints)."""
        return self.configured.equilibrium_for(self.used, equilibrium_rad, position_rad, velocity_rad_s)
