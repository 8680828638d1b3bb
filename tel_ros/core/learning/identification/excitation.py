"""Did the arm move in a way that tells its dynamics?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tel_ros.core.learning.identification.torque_samples import TorqueSamples
from tel_ros.core.types import FloatArray

MOST_CONDITION_OF_JOINT = 10.0
"""Where two of three standardised signals have a correlation of 0.98: their parts in a torque cannot be told
apart by a recording with noise."""
MOST_CONDITION_OF_ARM = 100.0
"""What is usual to ask of a movement that is to identify an arm (Gautier and Khalil, 1992)."""
LEAST_RANGE_RAD = 0.1
LEAST_ACCELERATION_SNR = 3.0
_KINDS = ("position", "velocity", "acceleration")


@dataclass(frozen=True)
class JointExcitation:
    """How a joint moved.

    Args:
        joint: name.
        position_rad: lowest and highest.
        velocity_rad_s: highest absolute value.
        acceleration_rad_s2: highest absolute value.
        condition: condition number of the joint's own standardised q, q̇, q̈.
        acceleration_snr: RMS acceleration over what noise makes of it.
    """

    joint: str
    position_rad: tuple[float, float]
    velocity_rad_s: float
    acceleration_rad_s2: float
    condition: float
    acceleration_snr: float


@dataclass(frozen=True)
class Excitation:
    """How an arm moved.

    Args:
        joints: one by one.
        condition: condition number of the standardised q, q̇, q̈ of all joints together.
    """

    joints: tuple[JointExcitation, ...]
    condition: float

    def warnings(self) -> list[str]:
        """Return what is poor about it, in words, each with what to do."""
        found = []
        for j in self.joints:
            low, high = j.position_rad
            if high - low < LEAST_RANGE_RAD:
                found.append(
                    f"{j.joint} moved within {high - low:.3g} rad only (expected at least "
                    f"{LEAST_RANGE_RAD:g}): what depends on its position is not learned"
                )
            if j.condition > MOST_CONDITION_OF_JOINT:
                found.append(
                    f"position, velocity and acceleration of {j.joint} go together (condition "
                    f"{j.condition:.3g}, expected at most {MOST_CONDITION_OF_JOINT:g}): inertia cannot be "
                    "told from what depends on position. Move it at several frequencies"
                )
            if j.acceleration_snr < LEAST_ACCELERATION_SNR:
                found.append(
                    f"the accelerations of {j.joint} are {j.acceleration_snr:.2g} times their noise "
                    f"(expected at least {LEAST_ACCELERATION_SNR:g}): move faster, or lower --cutoff-hz"
                )
        if self.condition > MOST_CONDITION_OF_ARM:
            found.append(
                f"the joints move together (condition {self.condition:.3g}, expected at most "
                f"{MOST_CONDITION_OF_ARM:g}): whose inertia makes a torque cannot be told. Move them on "
                "paths that differ"
            )
        return found


def excitation(joints: Sequence[str], parts: Sequence[TorqueSamples]) -> Excitation:
    """Return how well the recorded motion excites the dynamics."""
    inputs = np.vstack([part.inputs for part in parts])
    noise = np.sqrt(np.average([p.input_noise**2 for p in parts], axis=0, weights=[len(p) for p in parts]))
    n_joints = len(joints)
    found = []
    for j, joint in enumerate(joints):
        own = inputs[:, j::n_joints]
        snr = np.sqrt(np.mean(own[:, 2] ** 2)) / max(float(noise[2 * n_joints + j]), 1e-300)
        found.append(
            JointExcitation(
                joint=joint,
                position_rad=(float(own[:, 0].min()), float(own[:, 0].max())),
                velocity_rad_s=float(np.abs(own[:, 1]).max()),
                acceleration_rad_s2=float(np.abs(own[:, 2]).max()),
                condition=condition_number(own),
                acceleration_snr=float(snr),
            )
        )
    return Excitation(tuple(found), condition_number(inputs))


def condition_number(columns: FloatArray) -> float:
    """Return the ratio of the largest to the smallest singular value of standardised columns, or inf."""
    centred = columns - columns.mean(axis=0)
    spread = centred.std(axis=0)
    if not np.all(spread > 0.0):
        return float("inf")
    values = np.linalg.eigvalsh((centred / spread).T @ (centred / spread))
    return float(np.sqrt(values[-1] / values[0])) if values[0] > 0.0 else float("inf")


def input_name(joints: Sequence[str], column: int) -> str:
    """Return what a column of the inputs is, e.g. ``elbow velocity``."""
    kind, joint = divmod(column, len(joints))
    return f"{joints[joint]} {_KINDS[kind]}"
