"""What the network sees: positions, velocities and accelerations, scaled to the unit range."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tel_ros.core.trajectories.trajectory import DesiredTrajectory
from tel_ros.core.types import NS_PER_S, FloatArray


def stack_inputs(
    position_rad: FloatArray, velocity_rad_s: FloatArray, acceleration_rad_s2: FloatArray
) -> FloatArray:
    """Return the network's inputs (q, q̇, q̈): three arrays of shape (n, n_joints) as one (n, 3 * n_joints)."""
    return np.hstack([position_rad, velocity_rad_s, acceleration_rad_s2])


def input_name(joints: Sequence[str], column: int) -> str:
    """Return what a column of the inputs is, e.g. ``elbow velocity``."""
    kind, joint = divmod(column, len(joints))
    return f"{joints[joint]} {('position', 'velocity', 'acceleration')[kind]}"


def query_inputs(desired: DesiredTrajectory, control_period_s: float) -> FloatArray:
    """Return the inputs at which to ask for the commands of a desired trajectory. Shape (n, 3 * n_joints).

    The command of a tick acts during the interval that follows it, so it is paired with the mean acceleration
    of that interval, in the middle of it; training does the same (see :mod:`.signals`).
    """
    middle_ns = desired.time_ns + 0.5 * control_period_s * NS_PER_S
    acceleration = np.column_stack(
        [np.interp(middle_ns, desired.time_ns, a) for a in desired.acceleration_rad_s2.T]
    )
    return stack_inputs(desired.position_rad, desired.velocity_rad_s, acceleration)


@dataclass(frozen=True)
class InputRange:
    """The range of each input that is mapped to 0 … 1; values outside are clipped. Shapes (n_inputs,)."""

    low: FloatArray
    high: FloatArray

    @classmethod
    def covering(cls, goal: DesiredTrajectory, margin: float) -> InputRange:
        """Return ranges that cover the goal movement, widened by a factor about their middle.

        Velocities and accelerations are symmetric about zero: the same movement can be run backwards. An
        input that the goal movement leaves constant still gets a range of its unit's order of magnitude.
        """
        q_low, q_high = goal.position_rad.min(axis=0), goal.position_rad.max(axis=0)
        middle, half = 0.5 * (q_low + q_high), 0.5 * margin * (q_high - q_low)
        speed = margin * np.abs(goal.velocity_rad_s).max(axis=0)
        acceleration = margin * np.abs(goal.acceleration_rad_s2).max(axis=0)
        half, speed, acceleration = (np.where(x > 1e-6, x, 1.0) for x in (half, speed, acceleration))
        return cls(
            low=np.concatenate([middle - half, -speed, -acceleration]),
            high=np.concatenate([middle + half, speed, acceleration]),
        )

    @cached_property
    def width(self) -> FloatArray:
        """``high`` minus ``low``. Shape (n_inputs,)."""
        return self.high - self.low

    def scale(self, inputs: FloatArray) -> FloatArray:
        """Map inputs of shape (n, n_inputs) to 0 … 1."""
        # Late: numba takes a second of the start-up of processes that never learn.
        from tel_ros.core.learning import tree_kernels

        # Compiled, because a single sample costs NumPy several times as much.
        return tree_kernels.scale(inputs, self.low, self.width)
