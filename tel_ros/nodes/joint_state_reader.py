"""The arm's state, out of joint states as they come."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState

from tel_ros.core.arm_state import ArmState
from tel_ros.core.config import ArmConfig, ControlConfig
from tel_ros.core.control.velocity import MissingVelocities, VelocityEstimator
from tel_ros.core.errors import StateError
from tel_ros.core.safety.plausible import Plausibility
from tel_ros.core.safety.state_order import StateOrder
from tel_ros.nodes.conversions import time_ns
from tel_ros.recording.fixed_layout import JointStateLayout, JointStateNumbers


class JointStateReader:
    """Picks the arm's joints out of joint states, by name.

    Velocities that the arm does not tell (the field is empty, or NaN for a joint) are estimated.

    Args:
        arm: names, in the order of all arrays, and velocity limits, filled from the URDF where empty.
        control: how to estimate velocities, and for how long a state is awaited.
    """

    def __init__(self, arm: ArmConfig, control: ControlConfig) -> None:
        self._joints = list(arm.joints)
        self._velocities = MissingVelocities(
            VelocityEstimator(
                len(self._joints), cutoff_hz=control.velocity_filter_hz, max_gap_s=control.state_timeout_s
            )
        )
        self._order = StateOrder(control.state_timeout_s)
        self._plausibility = Plausibility(
            self._joints, np.array(arm.velocity_limit_rad_s), control.state_timeout_s
        )
        self._layout: JointStateLayout | None = None
        self._names: Sequence[str] | None = None
        self._columns: list[int] | slice = slice(None)

    @property
    def estimated(self) -> tuple[str, ...]:
        """Joints whose velocity is estimated at present."""
        indices = self._velocities.estimated
        return tuple(self._joints[k] for k in indices) if indices else ()

    def read_serialised(self, raw: bytes) -> ArmState:
        """Return the state of the arm's joints from a message as it came.

        Raises:
            StateError: the bytes are no joint state, or as for :meth:`read`.
        """
        numbers = self._layout.read(raw) if self._layout is not None else None
        if numbers is None:
            self._layout = JointStateLayout.of(raw)
            numbers = self._layout.read(raw) if self._layout is not None else None
        if numbers is not None:
            return self._state(self._layout.names, numbers)
        try:
            message = deserialize_message(raw, JointState)
        except RuntimeError as error:
            raise StateError(f"{len(raw)} bytes are no joint state ({error})") from error
        return self.read(message)

    def read(self, message: JointState) -> ArmState:
        """Return the state of the arm's joints.

        Raises:
            StateError: a joint is missing, a field has the wrong length, a value is not finite or cannot be,
                or a newer state has come before.
        """
        numbers = JointStateNumbers(
            time_ns(message.header.stamp), message.position, message.velocity, message.effort
        )
        return self._state(message.name, numbers)

    def _state(self, names: Sequence[str], numbers: JointStateNumbers) -> ArmState:
        if names is not self._names:
            self._find_columns(names)
        stamp_ns, positions, velocities, efforts = numbers
        n = len(names)
        if len(positions) != n or len(velocities) not in (n, 0):
            raise StateError(
                f"the joint state has {n} names, {len(positions)} positions and "
                f"{len(velocities)} velocities; expected as many of each, or no velocities"
            )
        overtaken_by_s = self._order.overtaken_by_s(stamp_ns)
        if overtaken_by_s:
            raise StateError(f"the joint state is {overtaken_by_s:.3f} s older than one that came before it")
        position_rad = np.array(positions)[self._columns]
        velocity = np.array(velocities)[self._columns] if velocities else np.full(len(self._joints), np.nan)
        self._plausibility.require(stamp_ns, position_rad, velocity)
        velocity_rad_s = self._velocities.fill(stamp_ns, position_rad, velocity)
        effort_nm = np.array(efforts)[self._columns] if len(efforts) == n else None
        return ArmState(stamp_ns, position_rad, velocity_rad_s, effort_nm=effort_nm)

    def _find_columns(self, names: Sequence[str]) -> None:
        """Find out where the arm's joints stand.

        Raises:
            StateError: one is missing.
        """
        missing = [joint for joint in self._joints if joint not in names]
        if missing:
            found = ", ".join(names) or "no joints"
            raise StateError(f"the joint state has {found}; expected also {', '.join(missing)}")
        columns = [names.index(joint) for joint in self._joints]
        self._columns = slice(None) if columns == list(range(len(names))) else columns
        self._names = names
