"""Limits of velocity and acceleration that keep efforts within theirs, for planners that know no dynamics."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from tel_ros.core.errors import TrajectoryError
from tel_ros.core.types import FloatArray

Efforts = Callable[[FloatArray], FloatArray]
"""Inverse dynamics of an arm with revolute joints: from (q, q̇, q̈), shape (n, 3 * n_joints), to τ in N·m."""


def joint_limits(
    efforts: Efforts,
    position_rad: FloatArray,
    velocity_rad_s: FloatArray,
    acceleration_rad_s2: FloatArray,
    limit_nm: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Return limits within which no movement through these postures needs more effort than it may.

    Whatever the joints do at the same time: all velocities and accelerations may come together with any sign.
    The limits are those of a movement, p · q̇ and p² · q̈ with the largest p up to 1: at equal shares of the
    duration a movement that is p times as fast has them.

    Args:
        efforts: what is known of the arm.
        position_rad: postures. Shape (n, n_joints).
        velocity_rad_s: the largest ones of the movement. Shape (n_joints,).
        acceleration_rad_s2: likewise.
        limit_nm: of the effort. Shape (n_joints,).

    Raises:
        TrajectoryError: gravity and friction alone need it all.
    """
    n_joints = position_rad.shape[1]
    each, still = np.eye(n_joints), np.zeros(n_joints)

    def needed(velocity: FloatArray, acceleration: FloatArray) -> FloatArray:
        rows = [np.broadcast_to(x, position_rad.shape) for x in (velocity, acceleration)]
        return efforts(np.hstack([position_rad, *rows]))

    rest_nm = needed(still, still)
    moved = {
        (j, k): velocity_rad_s * (each[j] + (each[k] if k != j else still))
        for j in range(n_joints)
        for k in range(j, n_joints)
    }
    # What does not change with the sign of the velocity is centrifugal and Coriolis, the rest is friction.
    both = {pair: (needed(v, still), needed(-v, still)) for pair, v in moved.items()}
    even = {pair: 0.5 * (ahead + back) - rest_nm for pair, (ahead, back) in both.items()}
    friction_nm = np.sum([0.5 * np.abs(np.subtract(*both[j, j])) for j in range(n_joints)], axis=0)
    dynamic_nm = [needed(still, acceleration_rad_s2 * row) - rest_nm for row in each]
    dynamic_nm += [even[j, k] - (even[j, j] + even[k, k] if k != j else 0.0) for j, k in moved]
    moved_nm = np.sum(np.abs(dynamic_nm), axis=0)
    left_nm = limit_nm - np.abs(rest_nm) - friction_nm
    if not np.all(left_nm > 0.0):
        n, j = np.unravel_index(int(np.argmin(left_nm / limit_nm)), left_nm.shape)
        raise TrajectoryError(
            f"gravity and friction may take {limit_nm[j] - left_nm[n, j]:.1f} N·m of joint {j + 1}, which "
            f"may use {limit_nm[j]:.1f} N·m: no limits of velocity and acceleration keep it within that"
        )
    p = min(1.0, float(np.sqrt(np.min(left_nm / np.maximum(moved_nm, 1e-12)))))
    return p * velocity_rad_s, p**2 * acceleration_rad_s2
