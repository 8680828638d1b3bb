"""Bringing a moving arm to rest without a plan."""

from __future__ import annotations

import numpy as np

from tel_ros.core.types import FloatArray

MOVING_RAD_S = 0.05
KEPT_SHARE = 0.5


class SpringBrake:
    """Chooses equilibrium points so that the virtual springs brake, and hold (ours, not the paper's).

    A spring that is latched where a fast arm happened to be would stop it and then fling it back: the
    default arm is under-damped. What else it may do depends on whether a weight pulls at the arm.

    Without one the brake works one way: each joint's equilibrium point stays where it was latched while
    the spring pulls against the motion, and moves along with the joint whenever it would pull with it. Then
    τ·q̇ <= 0 at every joint: no torque ever adds energy, and the arm comes to rest where it stops.

    Under a weight that would let the arm sink without end. So the deflection that held the arm when it was
    last at rest is kept all the time, and the deflection beyond it is halved whenever a joint turns round
    and its spring would push it along. Half of what a spring has given way by when a weight that fell into
    it turns round is just what carries the weight: so the deflection finds the load of another posture by
    itself. A spring then gives back at most a quarter of the energy that it has taken up, each time. Where
    nobody knows the load, what is kept counts as load from then on.

    Args:
        position_rad: where to latch. Shape (n_joints,).
        load_rad: deflection that holds the arm; all 0: it bears no weight; None: nobody knows whether it
            does. Shape (n_joints,).
    """

    def __init__(self, position_rad: FloatArray, load_rad: FloatArray | None) -> None:
        self._load_rad = np.zeros_like(position_rad) if load_rad is None else load_rad.copy()
        self._searches = load_rad is None
        self._one_way = load_rad is not None and not load_rad.any()
        self.latch(position_rad)

    def latch(self, position_rad: FloatArray) -> None:
        """Begin anew from a position, with what is known of the load. Shape (n_joints,)."""
        self._equilibrium_rad = position_rad + self._load_rad
        self._direction = np.zeros_like(position_rad)

    def equilibrium(
        self, position_rad: FloatArray, velocity_rad_s: FloatArray, at_rest: bool = False
    ) -> FloatArray:
        """Return the equilibrium points for the measured state. Shapes (n_joints,).

        Args:
            position_rad: as measured.
            velocity_rad_s: as measured.
            at_rest: the springs stay as they are: moving along with sensor noise would let the arm creep.
        """
        if at_rest:
            return self._equilibrium_rad
        beyond = self._equilibrium_rad - self._load_rad - position_rad
        if self._one_way:
            pulls_along = beyond * velocity_rad_s > 0.0
            self._equilibrium_rad = np.where(pulls_along, position_rad, self._equilibrium_rad)
            return self._equilibrium_rad
        moving = np.abs(velocity_rad_s) > MOVING_RAD_S
        direction = np.where(moving, np.sign(velocity_rad_s), self._direction)
        turned = (direction * self._direction < 0.0) & (beyond * direction > 0.0)
        self._direction = direction
        kept = KEPT_SHARE * beyond
        self._equilibrium_rad = np.where(turned, position_rad + self._load_rad + kept, self._equilibrium_rad)
        if self._searches:
            self._load_rad = np.where(turned, self._load_rad + kept, self._load_rad)
        return self._equilibrium_rad
