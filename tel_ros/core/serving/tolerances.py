"""Tolerances of a FollowJointTrajectory goal, as joint_trajectory_controller takes them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tel_ros.core.types import FloatArray


def tolerances(
    joints: Sequence[str], named: Sequence[str], position_rad: Sequence[float], configured_rad: float
) -> tuple[FloatArray, str]:
    """Return how far each joint may be off, shape (n_joints,), and what is wrong with what was asked for.

    A joint that is not named, and one with 0, has the configured tolerance, inf for none; one with -1 has
    none. Where something is wrong all have the configured one.
    """
    usual = np.full(len(joints), configured_rad)
    found = usual.copy()
    for name, tolerance in zip(named, position_rad, strict=True):
        if name not in joints:
            return usual, f"joint '{name}' of a tolerance does not exist. Using default tolerances"
        if not (tolerance >= 0.0 or tolerance == -1.0):
            return usual, f"joint '{name}' has the illegal tolerance {tolerance}. Using default tolerances"
        if tolerance:
            found[list(joints).index(name)] = tolerance if tolerance > 0.0 else np.inf
    return found, ""


def exceeded(joints: Sequence[str], error_rad: FloatArray, tolerance_rad: FloatArray) -> str:
    """Return which joint is further off than it may be, in words; empty: none is."""
    beyond = np.abs(error_rad) - tolerance_rad
    j = int(np.argmax(beyond))
    if beyond[j] <= 0.0:
        return ""
    return f"{joints[j]} is {abs(error_rad[j]):.4f} rad off (tolerance {tolerance_rad[j]:g} rad)"
