"""Bringing an arm to rest and holding it: is it at rest, what load do the springs bear, how do they brake.

Arrays have the shape (n_joints,).
"""

from __future__ import annotations

import math

import numpy as np

from tel_ros.core.arm_state import ArmState
from tel_ros.core.config import ControlConfig
from tel_ros.core.springs import Springs
from tel_ros.core.types import NS_PER_S, FloatArray


class RestDetector:
    """Says when no joint has moved for a while, or that this has taken too long.

    It looks at positions over the whole window instead of at the measured velocity, which a coarse encoder
    or noise can keep above any sensible threshold although the arm stands still. A joint is at rest if its
    mean speed over the window is below ``speed_rad_s``.
    """

    def __init__(self, speed_rad_s: float, window_s: float, timeout_s: float = math.inf) -> None:
        self._distance_rad = speed_rad_s * window_s
        self._window_ns, self._timeout_ns = round(window_s * NS_PER_S), timeout_s * NS_PER_S
        self._since_ns = self.begun_ns = 0
        self._reference_rad: list[float] | None = None
        self.still = False
        """Whether it was at rest in the last state."""

    @classmethod
    def of(cls, control: ControlConfig) -> RestDetector:
        """Return it as configured."""
        return cls(control.settle_speed_rad_s, control.settle_time_s, control.settle_timeout_s)

    def begin(self, time_ns: int) -> None:
        """Begin to wait for rest, with a new window."""
        self._reference_rad, self.still, self.begun_ns = None, False, time_ns

    def is_over(self, time_ns: int) -> bool:
        """Return whether the arm has come to rest, or has had its time."""
        return self.still or time_ns - self.begun_ns > self._timeout_ns

    def at_rest(self, time_ns: int, position_rad: FloatArray) -> bool:
        """Take in a measured position and return whether the arm is at rest by now."""
        positions, reference, most = position_rad.tolist(), self._reference_rad, self._distance_rad
        # In the control loop: so few numbers are compared faster one by one than as arrays.
        if (
            reference is None
            or time_ns < self._since_ns  # nobody knows for how long the arm has been where it is
            or any(not -most <= q - before <= most for q, before in zip(positions, reference))
        ):
            self._reference_rad, self._since_ns = positions, time_ns
        self.still = time_ns - self._since_ns >= self._window_ns
        return self.still


class HoldingLoad:
    """Remembers the effort that held the arm when it was last at rest: gravity, as far as springs know it."""

    SMOOTHING_S = 0.3
    """Efforts are smoothed, so that sensor noise in the damping does not count."""
    LEAST_DEFLECTION_RAD = 0.01
    """Less at every joint counts as no load: that much is what friction and the last of a motion leave."""

    def __init__(self) -> None:
        self._smooth_nm: list[float] | None = None
        self._last_ns = 0
        self.effort_nm: FloatArray | None = None
        """None: it has not been at rest under these springs."""

    def add(self, time_ns: int, effort_nm: FloatArray) -> None:
        """Take in one effort."""
        step_ns, self._last_ns = time_ns - self._last_ns, time_ns
        efforts, before = effort_nm.tolist(), self._smooth_nm
        if before is None or step_ns <= 0:
            self._smooth_nm = efforts
        else:
            share = -math.expm1(-step_ns / NS_PER_S / self.SMOOTHING_S)
            self._smooth_nm = [old + share * (new - old) for old, new in zip(before, efforts)]

    def keep(self) -> None:
        """Remember the present effort: the arm is at rest."""
        self.effort_nm = None if self._smooth_nm is None else np.array(self._smooth_nm)

    def lose(self, stiffness_nm_per_rad: FloatArray) -> None:
        """Forget a load, because nothing holds the arm where it was held. An arm without load stays one."""
        deflection = self.deflection_rad(stiffness_nm_per_rad)
        if deflection is None or deflection.any():
            self.effort_nm = None

    def deflection_rad(self, stiffness_nm_per_rad: FloatArray) -> FloatArray | None:
        """Return how far the load deflects springs; None: unknown. Zeros without load."""
        if self.effort_nm is None:
            return None
        deflection: FloatArray = self.effort_nm / stiffness_nm_per_rad
        loaded = np.abs(deflection).max() > self.LEAST_DEFLECTION_RAD
        return deflection if loaded else np.zeros_like(deflection)


class SpringBrake:
    """Chooses equilibrium points so that the virtual springs brake, and hold (ours, not the paper's).

    A spring that is latched where a fast arm happened to be would stop it and then fling it back: the
    default arm is under-damped. What else it may do depends on whether a weight pulls at the arm.

    Without one the brake works one way: each joint's equilibrium point stays where it was latched while
    the spring pulls against the motion, and moves along with the joint whenever it would pull with it. Then
    τ·q̇ <= 0 at every joint: no torque ever adds energy, and the arm comes to rest where it stops.

    Under a weight that would let the arm sink without end. So the deflection that held the arm when it was
    last at rest is kept all the time, and the deflection beyond it is halved whenever a joint turns round and
    its spring would push it along. Half of what a spring has given way by when a weight that fell into it
    turns round is just what carries the weight: so the deflection finds the load of another posture by
    itself. A spring then gives back at most a quarter of the energy that it has taken up, each time. Where
    the load is unknown, what is kept counts as load from then on. ``position_rad``: where to latch.
    ``load_rad``: deflection that holds the arm; all 0: it bears no weight; None: unknown.
    """

    MOVING_RAD_S = 0.05
    KEPT_SHARE = 0.5

    def __init__(self, position_rad: FloatArray, load_rad: FloatArray | None) -> None:
        self._load_rad = np.zeros_like(position_rad) if load_rad is None else load_rad.copy()
        self._searches = load_rad is None
        self._one_way = load_rad is not None and not load_rad.any()
        self.latch(position_rad)

    def latch(self, position_rad: FloatArray) -> None:
        """Begin anew from a position, with what is known of the load."""
        self._equilibrium_rad = position_rad + self._load_rad
        self._direction = np.zeros_like(position_rad)

    def equilibrium(
        self, position_rad: FloatArray, velocity_rad_s: FloatArray, at_rest: bool = False
    ) -> FloatArray:
        """Return the equilibrium points for a measured state."""
        if at_rest:  # following sensor noise would let the arm creep
            return self._equilibrium_rad
        beyond = self._equilibrium_rad - self._load_rad - position_rad
        if self._one_way:
            pulls_along = beyond * velocity_rad_s > 0.0
            self._equilibrium_rad = np.where(pulls_along, position_rad, self._equilibrium_rad)
            return self._equilibrium_rad
        moving = np.abs(velocity_rad_s) > self.MOVING_RAD_S
        direction = np.where(moving, np.sign(velocity_rad_s), self._direction)
        turned = (direction * self._direction < 0.0) & (beyond * direction > 0.0)
        self._direction = direction
        kept = self.KEPT_SHARE * beyond
        self._equilibrium_rad = np.where(turned, position_rad + self._load_rad + kept, self._equilibrium_rad)
        if self._searches:
            self._load_rad = np.where(turned, self._load_rad + kept, self._load_rad)
        return self._equilibrium_rad


class Hold:
    """Brakes the arm, holds it where it comes to rest, and knows what load the springs bear.

    A brake that is left with less than half of its effort (late states) is latched anew with every state, and
    after :attr:`FORGOTTEN_AFTER_S` of that the load is unknown: the arm is no longer where it was held.
    """

    FORGOTTEN_AFTER_S = 0.05

    def __init__(self) -> None:
        self.load = HoldingLoad()
        self._brake: SpringBrake | None = None
        self._late_since_ns: int | None = None

    def begin(self) -> None:
        """Latch anew at the next state."""
        self._brake = self._late_since_ns = None

    def lose(self, springs: Springs) -> None:
        """Latch anew and forget the load, because nothing holds the arm: springs must not be wound up."""
        self.load.lose(springs.stiffness_nm_per_rad)
        self._brake = None

    def equilibrium(self, state: ArmState, springs: Springs, at_rest: bool, late: bool = False) -> FloatArray:
        """Return the equilibrium points that brake the arm. ``late``: less than half of the effort acts."""
        if not late:
            self._late_since_ns = None
        else:
            if self._late_since_ns is None:
                self._late_since_ns = state.time_ns
            if state.time_ns - self._late_since_ns > self.FORGOTTEN_AFTER_S * NS_PER_S:
                self.lose(springs)
            elif self._brake is not None:
                self._brake.latch(state.position_rad)
        if self._brake is None:
            load_rad = self.load.deflection_rad(springs.stiffness_nm_per_rad)
            self._brake = SpringBrake(state.position_rad, load_rad)
        return self._brake.equilibrium(state.position_rad, state.velocity_rad_s, at_rest)
