"""Joint velocities from stamped positions, for arms that report none."""

from __future__ import annotations

import math

import numpy as np

from tel_ros.core.errors import ConfigError, StateError
from tel_ros.core.types import NS_PER_S, BoolArray, FloatArray


class VelocityEstimator:
    """Differences of successive positions through a first-order low-pass.

    v ← v + (1 − exp(−2π f Δt)) ((q − q_last) / Δt − v): the low-pass solved exactly for an input that is
    constant between two stamps, so that it is stable for every corner frequency f and every Δt. It looks back
    only, as the control loop has to. The price is a lag: at a constant acceleration the estimate is late by
    Δt/2 for the difference and Δt / (exp(2π f Δt) − 1) for the low-pass (:meth:`lag_s`); 1.8 ms in all with
    500 Hz and f = 100 Hz. An encoder step of s rad shows up as a velocity of at most
    s (1 − exp(−2π f Δt)) / Δt: 0.034 rad/s with 16 bits, but 0.55 rad/s with 12.

    After a start, a gap or stamps that went back, nothing is known of the velocity: it is 0 at the first
    position, and the plain difference at the second.

    Args:
        n_joints: number of joints.
        cutoff_hz: corner frequency f of the low-pass.
        max_gap_s: positions further apart than this do not belong to one movement.

    Raises:
        ConfigError: a value is not finite and above 0.
    """

    def __init__(self, n_joints: int, *, cutoff_hz: float, max_gap_s: float) -> None:
        for key, value in (("cutoff_hz", cutoff_hz), ("max_gap_s", max_gap_s)):
            if not 0.0 < value < math.inf:  # written so that NaN fails
                raise ConfigError(key, value, "a finite number above 0")
        self._n_joints = n_joints
        self._rate_rad_s = 2.0 * math.pi * cutoff_hz
        self._max_gap_ns = round(max_gap_s * NS_PER_S)
        self._last_ns: int | None = None
        self._position_rad = np.zeros(n_joints)
        self._velocity_rad_s = np.zeros(n_joints)
        self._has_difference = False

    def lag_s(self, period_s: float) -> float:
        """Return how late the estimate is at a constant acceleration, if a position comes every period."""
        kept = math.exp(-self._rate_rad_s * period_s)
        return period_s * (0.5 + kept / (1.0 - kept))

    def update(self, time_ns: int, position_rad: FloatArray) -> FloatArray:
        """Take in the next position and return the velocity.

        A position with the stamp of the last one changes nothing: the state was sent again.

        Args:
            time_ns: stamp of the position.
            position_rad: as measured. Shape (n_joints,).

        Returns:
            The velocity in rad/s. Shape (n_joints,).

        Raises:
            StateError: another number of joints, or a position that is not finite; it is not taken in.
        """
        if position_rad.shape != (self._n_joints,) or not np.isfinite(position_rad.sum()):
            raise StateError(
                f"the positions are {position_rad.tolist()} rad; expected {self._n_joints} finite numbers"
            )
        step_ns = 0 if self._last_ns is None else time_ns - self._last_ns
        if self._last_ns is None or not 0 <= step_ns <= self._max_gap_ns:
            self._velocity_rad_s = np.zeros(self._n_joints)
            self._has_difference = False
        elif step_ns == 0:
            return self._velocity_rad_s
        else:
            step_s = step_ns / NS_PER_S
            difference_rad_s = (position_rad - self._position_rad) / step_s
            share = -math.expm1(-self._rate_rad_s * step_s) if self._has_difference else 1.0
            self._velocity_rad_s = self._velocity_rad_s + share * (difference_rad_s - self._velocity_rad_s)
            self._has_difference = True
        self._last_ns, self._position_rad = time_ns, position_rad.copy()
        return self._velocity_rad_s


class MissingVelocities:
    """Fills in what an arm does not tell of its joints' velocities.

    A joint whose velocity is NaN has none (that is how the stock ``joint_state_broadcaster`` says it): its
    velocity is estimated. A joint that has told its velocity once is never estimated from then on: NaN is a
    fault there, and is handed on as such.

    Args:
        estimator: for the joints that tell none.
    """

    def __init__(self, estimator: VelocityEstimator) -> None:
        self._estimator = estimator
        self._told: BoolArray | None = None
        self._all_told = False
        self.estimated: tuple[int, ...] = ()
        """Which joints are estimated at present, by index."""

    def fill(self, time_ns: int, position_rad: FloatArray, velocity_rad_s: FloatArray) -> FloatArray:
        """Return the velocities, those that are missing estimated.

        Args:
            time_ns: stamp of the state.
            position_rad: as measured. Shape (n_joints,).
            velocity_rad_s: as reported, NaN where nothing was. Shape (n_joints,).

        Raises:
            StateError: velocities are missing, and the positions cannot be used.
        """
        if self._all_told:
            return velocity_rad_s
        told = np.isfinite(velocity_rad_s)
        self._told = told if self._told is None else self._told | told
        self._all_told = bool(self._told.all())
        self.estimated = tuple(np.flatnonzero(~self._told).tolist())
        if self._all_told:
            return velocity_rad_s
        missing = np.isnan(velocity_rad_s) & ~self._told
        return np.where(missing, self._estimator.update(time_ns, position_rad), velocity_rad_s)
