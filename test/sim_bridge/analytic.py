"""The planar two-link arm in formulas: what the simulated one is compared with."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class PlanarArm:
    """M(q) q̈ + h(q, q̇) = τ - b q̇ - c sign(q̇), with the numbers of planar_arm.urdf as defaults."""

    length_m: float = 0.33
    centre_m: float = 0.165
    mass_kg: tuple[float, float] = (2.0, 1.2)
    inertia_kgm2: tuple[float, float] = (0.05, 0.02)
    inertia_scale: float = 1.0
    payload_kg: float = 0.0
    viscous_nms_per_rad: tuple[float, float] = (0.05, 0.05)
    coulomb_nm: tuple[float, float] = (0.0, 0.0)

    def _coupling(self) -> float:
        forearm_kg = self.inertia_scale * self.mass_kg[1]
        return self.length_m * (forearm_kg * self.centre_m + self.payload_kg * self.length_m)

    def mass_matrix(self, q: FloatArray) -> FloatArray:
        """Return M(q) in kg·m². Shape (2, 2)."""
        m1, m2 = self.inertia_scale * np.array(self.mass_kg)
        i1, i2 = self.inertia_scale * np.array(self.inertia_kgm2)
        k = self._coupling() * np.cos(q[1])
        elbow = i2 + m2 * self.centre_m**2 + self.payload_kg * self.length_m**2
        carried = i1 + m1 * self.centre_m**2 + (m2 + self.payload_kg) * self.length_m**2
        return np.array([[carried + elbow + 2.0 * k, elbow + k], [elbow + k, elbow]])

    def velocity_torque(self, q: FloatArray, v: FloatArray) -> FloatArray:
        """Return the Coriolis and centrifugal torques h(q, q̇) in N·m. Shape (2,)."""
        k = self._coupling() * np.sin(q[1])
        return np.array([-k * (2.0 * v[0] * v[1] + v[1] ** 2), k * v[0] ** 2])

    def acceleration(self, q: FloatArray, v: FloatArray, torque_nm: FloatArray) -> FloatArray:
        """Return q̈ in rad/s² of an arm whose joints all slide. Shape (2,)."""
        friction_nm = np.array(self.viscous_nms_per_rad) * v + np.array(self.coulomb_nm) * np.sign(v)
        return np.linalg.solve(self.mass_matrix(q), torque_nm - self.velocity_torque(q, v) - friction_nm)

    def kinetic_energy(self, q: FloatArray, v: FloatArray) -> float:
        """Return the energy in J."""
        return float(0.5 * v @ self.mass_matrix(q) @ v)
