"""A simulated arm that keeps the promises of a real one behind ros2_control, without ROS.

Time passes in control periods. :meth:`SimulatedArm.reading` tells the state at time t, and the effort that
acted until t. :meth:`SimulatedArm.step` takes the command for t: it is clipped, waits for the command delay
(if any) and then acts, constant, until t + period. So the state at t never feels the command of t.

With ``arm.command_interface: position`` the command is a set point, and what acts until t + period is what
the drive makes of it at the rate of the physics.

Equal configuration, seed and commands give bit-identical readings, in any process.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from contextlib import AbstractContextManager
from fractions import Fraction
from functools import partial
from typing import NamedTuple

from sim_bridge.physics import ArmPhysics, SimulationError
from sim_bridge.sensors import JointSensors
from tel_ros.core.config import ArmConfig, JointValues, SimConfig
from tel_ros.core.errors import ConfigError, TelError
from tel_ros.recording.urdf import described


class CommandError(TelError):
    """A command cannot be used. Nothing was applied and no time has passed."""


class ArmReading(NamedTuple):
    """What the arm reports once a control period: one value a joint, in the order of the configuration."""

    time_ns: int
    """Arm time since the start."""
    position_rad: JointValues
    """From the encoders."""
    velocity_rad_s: JointValues
    """As a drive estimates it from the encoders."""
    effort_nm: JointValues
    """What the motors did until ``time_ns``, for one period (where drives take positions: one physics step):
    after clipping and delay, before friction."""


class PositionDrive(NamedTuple):
    """The control law τ = K (u - q) - B q̇ with |τ| limited, as a drive evaluates it at its own, high rate.

    Its position and velocity are the true ones: a drive measures finer than what the joint states tell.
    """

    stiffness_nm_per_rad: JointValues
    damping_nms_per_rad: JointValues
    effort_limit_nm: JointValues

    def effort_nm(
        self, set_point_rad: JointValues, position_rad: JointValues, velocity_rad_s: JointValues
    ) -> JointValues:
        """Return the torque of each motor at a state, for a set point u."""
        rows = zip(*self, set_point_rad, position_rad, velocity_rad_s, strict=True)
        return tuple(max(-limit, min(limit, k * (u - q) - b * v)) for k, b, limit, u, q, v in rows)


class SimulatedArm(AbstractContextManager["SimulatedArm"]):
    """An arm that takes efforts, or set points, at rest in its initial posture. Use it with ``with``.

    Drives that take set points hold the initial posture at first.

    The weaker of the arm's effort limit and the URDF's applies. Friction in ``sim`` replaces the URDF's;
    ``inertia_scale`` applies to the links, not to the payload. ``rate_hz``: of control. ``seed``: of the
    sensor noise. Raises InputFileError: the URDF cannot be read or simulated; ConfigError: a value does not
    fit the URDF, or does not fit the other values.
    """

    def __init__(self, arm: ArmConfig, sim: SimConfig, *, rate_hz: float, seed: int) -> None:
        description = described(arm)
        self.joint_names = arm.joints
        self.effort_limit_nm: JointValues = tuple(
            min(own, limit.effort_nm)
            for own, limit in zip(arm.effort_limit_nm, description.limits, strict=True)
        )
        stops_rad = low_rad, high_rad = description.stops_rad(arm)
        self._range_rad = tuple(zip(*stops_rad, strict=True))
        substeps = sim.physics_rate_hz / rate_hz
        if not (substeps >= 1.0 and abs(substeps - round(substeps)) < 1e-9):
            expected = f"a whole multiple of the control rate {rate_hz}"
            raise ConfigError("sim.physics_rate_hz", sim.physics_rate_hz, expected)
        self._n_substeps = round(substeps)
        self._period_ns = (1_000_000_000 / Fraction(rate_hz)).as_integer_ratio()
        self._n_ticks = 0
        self._zero: JointValues = (0.0,) * len(arm.joints)
        self._newest = self._zero
        self._drive: PositionDrive | None = None
        if arm.command_interface == "position":
            stiffness = tuple(sim.drive_stiffness_scale * k for k in arm.stiffness_nm_per_rad)
            self._drive = PositionDrive(stiffness, arm.damping_nms_per_rad, self.effort_limit_nm)
        delay = sim.command_delay_s * rate_hz
        if abs(delay - round(delay)) > 1e-6:
            expected = f"a whole multiple of the control period {1.0 / rate_hz:g} s"
            raise ConfigError("sim.command_delay_s", sim.command_delay_s, expected)
        self._on_the_way = deque([self._zero] * round(delay))
        self._sensors = JointSensors(len(arm.joints), sim, period_s=1.0 / rate_hz, seed=seed)
        ends = zip(arm.position_min_rad or low_rad, arm.position_max_rad or high_rad, strict=True)
        # A joint without limits starts at zero.
        middle = tuple(0.5 * (a + b) if math.isfinite(a) and math.isfinite(b) else 0.0 for a, b in ends)
        start_rad = self._per_joint(sim, "initial_position_rad") or middle
        self._check_position("sim.initial_position_rad", start_rad)
        self._physics = ArmPhysics(
            description,
            arm,
            sim,
            self._per_joint(sim, "viscous_friction_nms_per_rad") or description.viscous_friction_nms_per_rad,
            self._per_joint(sim, "coulomb_friction_nm") or description.coulomb_friction_nm,
        )
        self.set_state(start_rad, self._zero)

    def __exit__(self, *error: object) -> None:
        """Close the arm."""
        self.close()

    def close(self) -> None:
        """End the simulation. A second time does nothing."""
        self._physics.close()

    @property
    def time_ns(self) -> int:
        """Arm time since the start, made from the number of periods so that no rounding adds up."""
        numerator, denominator = self._period_ns
        return self._n_ticks * numerator // denominator

    def at_rest(self, speed_rad_s: float = 1e-3) -> bool:
        """Whether every joint is truly slower than ``speed_rad_s``."""
        return all(abs(velocity) < speed_rad_s for velocity in self.true_velocity_rad_s)

    def reading(self) -> ArmReading:
        """Return what the sensors report now: the same record until the next step."""
        return self._reading

    def step(self, command: Sequence[float]) -> None:
        """Take the torque of each motor in N·m, or a drive's set point in rad, and let one period pass.

        Raises CommandError: wrong length or not finite. Nothing is applied and no time passes;
        SimulationError: the simulation was closed, or is no longer finite.
        """
        values = tuple(map(float, command))
        if len(values) != len(self._zero) or not all(map(math.isfinite, values)):
            name, unit = ("effort command", "N·m") if self._drive is None else ("set point", "rad")
            raise CommandError(
                f"the {name} is {list(values)}; expected {len(self._zero)} finite numbers of {unit}, "
                f"one for each of the joints {', '.join(self.joint_names)}"
            )
        if self._drive is None:
            limited = zip(values, self.effort_limit_nm, strict=True)
            values = tuple([max(-limit, min(limit, value)) for value, limit in limited])
        self._newest = values
        self._on_the_way.append(values)
        self._advance(self._on_the_way.popleft())

    def coast(self) -> None:
        """Let a period pass without a command: the motors are off; drives go on with the newest set point."""
        if self._drive is None:
            self._newest = self._zero
            self._forget_commands()
        self._on_the_way.append(self._newest)
        self._advance(self._on_the_way.popleft())

    def set_state(self, position_rad: Sequence[float], velocity_rad_s: Sequence[float]) -> None:
        """Put the arm into a state, which position drives hold; ConfigError: it cannot be. Time stays."""
        self._check_position("position_rad", position_rad)
        if len(velocity_rad_s) != len(self._zero) or not all(map(math.isfinite, velocity_rad_s)):
            expected = f"a finite velocity for each of the joints {', '.join(self.joint_names)}"
            raise ConfigError("velocity_rad_s", list(velocity_rad_s), expected)
        self._physics.set_state(position_rad, velocity_rad_s)
        self._newest = self._zero if self._drive is None else tuple(position_rad)
        self._forget_commands()
        self.true_position_rad, self.true_velocity_rad_s = self._physics.state()
        """Without sensors, for tests and studies."""
        self._sensors.start(self.true_position_rad, self.true_velocity_rad_s)
        self._reading = self._new_reading(self._zero)

    def _forget_commands(self) -> None:
        """Have the newest command arrive instead of those that are on their way."""
        self._on_the_way = deque([self._newest] * len(self._on_the_way))

    def _advance(self, command: JointValues) -> None:
        if self._drive is None:
            effort_nm = command
            self._physics.advance(effort_nm, self._n_substeps)
        else:
            effort_nm = self._physics.advance_driven(
                partial(self._drive.effort_nm, command), self._n_substeps
            )
        self._n_ticks += 1
        self.true_position_rad, self.true_velocity_rad_s = self._physics.state()
        if not all(map(math.isfinite, self.true_position_rad + self.true_velocity_rad_s)):
            raise SimulationError(
                f"the simulation diverged at {self.time_ns * 1e-9:.4f} s. Use a higher sim.physics_rate_hz, "
                "less friction or more inertia."
            )
        self._sensors.update(self.true_position_rad, self.true_velocity_rad_s)
        self._reading = self._new_reading(effort_nm)

    def _new_reading(self, effort_nm: JointValues) -> ArmReading:
        return ArmReading(self.time_ns, self._sensors.position_rad, self._sensors.velocity_rad_s, effort_nm)

    def _per_joint(self, sim: SimConfig, key: str) -> JointValues:
        values: JointValues = getattr(sim, key)
        if len(values) not in (0, len(self.joint_names)):
            expected = f"nothing, or one value for each of the joints {', '.join(self.joint_names)}"
            raise ConfigError(f"sim.{key}", list(values), expected)
        return values

    def _check_position(self, key: str, position_rad: Sequence[float]) -> None:
        if len(position_rad) != len(self._range_rad) or not all(
            math.isfinite(value) and low <= value <= high
            for value, (low, high) in zip(position_rad, self._range_rad, strict=True)
        ):
            ranges = ", ".join(
                f"{name} {low:g} to {high:g}"
                for name, (low, high) in zip(self.joint_names, self._range_rad, strict=True)
            )
            raise ConfigError(key, list(position_rad), f"one value in rad a joint, within {ranges}")
