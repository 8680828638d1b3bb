"""Bringing a moving arm to rest without a plan."""

from __future__ import annotations

import numpy as np

from tel_ros.core.types import FloatArray


class OneWayBrake:
    """Chooses equilibrium points so that the virtual springs only ever brake (ours, not the paper's).

    A spring that is latched where a fast arm happened to be would stop it and then fling it back: the
    default arm is under-damped. So each joint's equilibrium point stays where it was latched while the
    spring pulls against the motion, and moves along with the joint whenever it would pull with it. Then
    τ·q̇ <= 0 at every joint: no torque ever adds energy, and the arm comes to rest where it stops.
    """

    def __init__(self, position_rad: FloatArray) -> None:
        self._equilibrium_rad = position_rad.copy()

    def equilibrium(self, position_rad: FloatArray, velocity_rad_s: FloatArray) -> FloatArray:
        """Return the equilibrium points for the measured state. Shapes (n_joints,)."""
        pulls_along = (self._equilibrium_rad - position_rad) * velocity_rad_s > 0.0
        self._equilibrium_rad = np.where(pulls_along, position_rad, self._equilibrium_rad)
        return self._equilibrium_rad
