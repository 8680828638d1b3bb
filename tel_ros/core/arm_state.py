"""One measured state of the arm."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from tel_ros.core.errors import StateError
from tel_ros.core.types import FloatArray


@dataclass(frozen=True)
class ArmState:
    """One measured state. Arrays of shape (n_joints,); StateError: a position or velocity is not finite."""

    time_ns: int
    position_rad: FloatArray
    velocity_rad_s: FloatArray
    age_s: float = 0.0
    """How late it has come (:class:`~tel_ros.core.safety.gate.Latency`); 0 where none can tell."""
    effort_nm: FloatArray | None = None
    """What the motors are said to have exerted until then; None: nothing is said."""
    estimated: bool = False
    """Whether velocities are missing, and estimated from the positions."""
    positions: list[float] = field(init=False, repr=False, compare=False)
    velocities: list[float] = field(init=False, repr=False, compare=False)
    """The same numbers as lists: in the control loop so few are compared faster one by one."""

    def __post_init__(self) -> None:
        positions, velocities = self.position_rad.tolist(), self.velocity_rad_s.tolist()
        object.__setattr__(self, "positions", positions)
        object.__setattr__(self, "velocities", velocities)
        # A sum is finite only if all of its terms are, and in the control loop it costs less than isfinite.
        if not math.isfinite(sum(positions) + sum(velocities)):
            raise StateError(
                f"the joint state has position {positions} rad and velocity {velocities} rad/s; "
                "expected finite numbers"
            )
