"""The arm that is judged: limits, and how far it may go that springs brake, by energy and weight."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tel_lab.exact_model import ExactInverseDynamics
from tel_ros.core.config import Config
from tel_ros.core.safety.motion_rules import soft_range
from tel_ros.core.types import FloatArray

GIVEN_BACK = 0.5
"""Most that springs and soft walls give back of the energy of an arm that they catch. A spring of the brake
gives back a quarter each time (core/control/holding.py); the simulated iiwa, caught after a second of
falling, got up to 5.6 J back with 9.4 J of kinetic energy at most."""


@dataclass(frozen=True)
class Body:
    """Springs, limits, inertia and weight of an arm.

    ``torque_nm``: what makes the arm at rest in some postures accelerate so, from positions and accelerations
    of shape (n, n_joints), which is also its shape. The others: shape (n_joints,).
    """

    stiffness_nm_per_rad: FloatArray
    torque_nm: Callable[[FloatArray, FloatArray], FloatArray]
    soft_min_rad: FloatArray
    soft_max_rad: FloatArray
    effort_limit_nm: FloatArray
    velocity_limit_rad_s: FloatArray
    position_min_rad: FloatArray
    position_max_rad: FloatArray

    @classmethod
    def of(cls, config: Config) -> Body:
        """Return the body that is simulated for a configuration."""
        arm, stiffness = config.arm, np.array(config.arm.stiffness_nm_per_rad)
        limits = (arm.effort_limit_nm, arm.velocity_limit_rad_s, arm.position_min_rad, arm.position_max_rad)
        model = ExactInverseDynamics(config, config.sim)

        def torque_nm(position_rad: FloatArray, acceleration_rad_s2: FloatArray) -> FloatArray:
            inputs = np.hstack([position_rad, np.zeros_like(position_rad), acceleration_rad_s2])
            return stiffness * model.predict(inputs)

        return cls(stiffness, torque_nm, *soft_range(arm, config.safety), *map(np.array, limits))

    def kinetic_energy_j(self, position_rad: FloatArray, velocity_rad_s: FloatArray) -> FloatArray:
        """Return ½ q̇ᵀ M q̇ in J. Shapes (n, n_joints), result (n,)."""
        inertia = self.torque_nm(position_rad, velocity_rad_s) - self.weight_nm(position_rad)
        return 0.5 * np.einsum("ij,ij->i", velocity_rad_s, inertia)

    def weight_nm(self, position_rad: FloatArray) -> FloatArray:
        """Return the torque that holds the arm. Shapes (n, n_joints)."""
        return self.torque_nm(position_rad, np.zeros_like(position_rad))

    def sagging_j(self, position_rad: FloatArray) -> float:
        """Return the energy that springs take up by the arm's weight alone when they catch it in a posture.

        A joint of weight g goes down by twice what its spring K sags by, 2 g / K, until it turns round. Its
        weight has done 2 g² / K until then; on the way back up the springs do that work.
        """
        weight_nm = self.weight_nm(position_rad[None])[0]
        return float(np.sum(2.0 * weight_nm**2 / self.stiffness_nm_per_rad))

    def led_back_j(self, position_rad: FloatArray) -> float:
        """Return the work that lifts joints caught beyond their soft limits back to these."""
        inside_rad = np.clip(position_rad, self.soft_min_rad, self.soft_max_rad)
        weight_nm = self.weight_nm(position_rad[None])[0]
        return float(np.sum(np.abs(weight_nm * (position_rad - inside_rad))))

    def reach_rad(self, position_rad: FloatArray, energy_j: float) -> FloatArray:
        """Return how far each joint may go from a posture until springs latched there have stopped it.

        All of the energy may go into any one joint. Its spring takes up ½ K x², its weight adds |g| x:
        x = (|g| + √(g² + 2 K E)) / K. With no energy that is twice what the spring sags by.
        """
        k, g = self.stiffness_nm_per_rad, np.abs(self.weight_nm(position_rad[None])[0])
        return (g + np.sqrt(g**2 + 2.0 * k * energy_j)) / k
