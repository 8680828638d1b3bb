"""The referee: how fast a known arm can run a path at all, by the toppra package."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np

from tel_ros.core.config import ArmConfig
from tel_ros.core.errors import TrajectoryError
from tel_ros.core.learning.inputs import stack_inputs
from tel_ros.core.trajectories.paths import Derivatives, Path
from tel_ros.core.types import NS_PER_S, FloatArray, IntArray

GRID = 1000
"""Intervals along the path; twice as many change the duration by less than 0.1 %."""
_ITERATIONS, _CONVERGED = 60, 1e-4
Model = Callable[[FloatArray], FloatArray]
"""Inverse dynamics as a learner has them: from (q, q̇, q̈) to u - q in rad."""


@dataclass(frozen=True)
class TimeBound:
    """The time-optimal way along a path, from rest to rest: ds/dt at each s. Shapes (n,)."""

    s: FloatArray
    rate: FloatArray

    @property
    def time_s(self) -> FloatArray:
        return np.concatenate([[0.0], np.cumsum(2.0 * np.diff(self.s) / (self.rate[1:] + self.rate[:-1]))])

    @property
    def duration_s(self) -> float:
        return float(self.time_s[-1])

    def at(self, time_ns: IntArray) -> Derivatives:
        """Return s, ds/dt and d²s/dt²: as a timing, with the jumps of effort that no drive can follow."""
        time_s = np.clip(time_ns / NS_PER_S, 0.0, self.duration_s)
        k = np.clip(np.searchsorted(self.time_s, time_s, side="right") - 1, 0, len(self.s) - 2)
        dds = 0.5 * np.diff(self.rate**2) / np.diff(self.s)
        t = time_s - self.time_s[k]
        return self.s[k] + t * (self.rate[k] + 0.5 * t * dds[k]), self.rate[k] + t * dds[k], dds[k]


def time_bound(arm: ArmConfig, model: Model, path: Path, share: float = 1.0, grid: int = GRID) -> TimeBound:
    """Return the fastest way along a path within the limits of effort and velocity; efforts may jump.

    Along the path τ = a s̈ + b ṡ² + d ṡ + c, with gravity and dry friction in c. toppra knows no term in ṡ:
    viscous friction is put in at the speed of the solution before, until the duration no longer changes.
    ``share``: of the effort limits that may be used.

    Raises:
        TrajectoryError: the arm cannot run the path at any speed, since it cannot hold itself up.
    """
    import toppra  # late: an extra
    from toppra.constraint import DiscretizationType, LinearConstraint
    from toppra.constraint.linear_constraint import canlinear_colloc_to_interpolate

    logging.getLogger("toppra").setLevel(logging.CRITICAL)
    s = np.linspace(0.0, 1.0, grid + 1)
    a, b, d, c = (term / np.array(arm.effort_limit_nm) for term in _terms(arm, model, path, s))
    # A joint that turns round for a moment has no say.
    slope = np.maximum(np.abs(path.evaluate(s)[1]), 1e-12)
    fastest = np.min(np.array(arm.velocity_limit_rad_s) / slope, axis=1)
    sides = np.vstack([np.eye(path.n_joints), -np.eye(path.n_joints)])

    class Limits(LinearConstraint):  # type: ignore[misc]
        """Efforts are within their limits at both ends of each interval, velocities at each point."""

        def __init__(self, rest: FloatArray) -> None:
            super().__init__()
            self.identical, self.dof, self._rest = True, path.n_joints, rest
            self.discretization_type = DiscretizationType.Interpolation

        def compute_constraint_params(self, _: Any, gridpoints: FloatArray) -> Any:
            bounds = np.full(len(sides), share), None, np.column_stack([np.zeros(len(s)), fastest**2])
            terms = (a, b, self._rest, sides, *bounds, gridpoints)
            return canlinear_colloc_to_interpolate(*terms, identical=True)

    geometry = SimpleNamespace(dof=path.n_joints, path_interval=(0.0, 1.0))
    assumed, last_s = np.zeros(len(s)), np.inf
    for _ in range(_ITERATIONS):
        limits = Limits(c + d * assumed[:, None])
        solver = toppra.algorithm.TOPPRA([limits], geometry, s, solver_wrapper="seidel")
        _, rate, _ = solver.compute_parameterization(0.0, 0.0)
        if rate is None or not np.all(np.isfinite(rate)):
            raise TrajectoryError(f"the arm cannot run the path {path.name} within its effort limits")
        found = TimeBound(s, rate)
        if abs(found.duration_s - last_s) < _CONVERGED * last_s:
            break
        assumed, last_s = 0.5 * (assumed + rate) if np.any(assumed) else rate, found.duration_s
    return found


def _terms(
    arm: ArmConfig, model: Model, path: Path, s: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return a, b, d and c in N·m at each s. Shapes (n, n_joints).

    What changes sign with the speed is friction; asked at one and at two times dq/ds, it tells how much of
    it is viscous.
    """
    stiffness, damping = np.array(arm.stiffness_nm_per_rad), np.array(arm.damping_nms_per_rad)
    q, dq, ddq = path.evaluate(s)
    still = np.zeros_like(q)

    def torque_nm(v: FloatArray, acceleration: FloatArray) -> FloatArray:
        return stiffness * model(stack_inputs(q, v, acceleration)) - damping * v

    rest = torque_nm(still, still)
    ahead, back = torque_nm(dq, ddq), torque_nm(-dq, ddq)
    friction = 0.5 * (ahead - back)
    viscous = 0.5 * (torque_nm(2.0 * dq, still) - torque_nm(-2.0 * dq, still)) - friction
    return torque_nm(still, dq) - rest, 0.5 * (ahead + back) - rest, viscous, rest + friction - viscous
