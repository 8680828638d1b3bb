"""Commands and control states as bytes, for the control loop and the arm.

What is written here is what rclpy would make of a message; what is read here is left to rclpy where its
layout is not one of ours (a driver may dress its messages as it likes).
"""

from __future__ import annotations

from rclpy.serialization import deserialize_message
from std_msgs.msg import Float64MultiArray

from tel_ros.core.arm_state import ArmState
from tel_ros.core.errors import StateError
from tel_ros.core.trial import Tick
from tel_ros.core.types import FloatArray
from tel_ros.nodes.conversions import answering_label
from tel_ros.recording.fixed_layout import (
    CommandLayout,
    CommandNumbers,
    ControlStateLayout,
    command_layout,
)


class CommandReader:
    """Reads commands: efforts, or set points."""

    def __init__(self) -> None:
        self._layout: CommandLayout | None = None

    def read(self, raw: bytes) -> CommandNumbers:
        """Return what a serialised command says.

        Raises:
            StateError: the bytes are no command.
        """
        numbers = self._layout.read(raw) if self._layout is not None else None
        if numbers is None:
            self._layout = CommandLayout.of(raw)
            numbers = self._layout.read(raw) if self._layout is not None else None
        if numbers is not None:
            return numbers
        try:
            message = deserialize_message(raw, Float64MultiArray)
        except RuntimeError as error:
            raise StateError(f"{len(raw)} bytes are no command ({error})") from error
        return CommandNumbers(answering_label(message), tuple(message.data))


def packed_command(label: str, values: FloatArray) -> bytes:
    """Return a command (efforts, or equilibrium points), marked with a label.

    Stock controllers do not look at the layout of the array. The simulated arm in lockstep and the recorder
    do: its one dimension is labelled with the stamp of the joint state that it answers, in nanoseconds.

    Args:
        label: the stamp, or the name of who commands without answering.
        values: shape (n_joints,).
    """
    encoded = label.encode()
    return command_layout(len(values), len(encoded)).packed(encoded, values.tolist())


class ControlStatePacker:
    """Turns ticks into messages.

    Args:
        n_joints: length of all arrays.
    """

    def __init__(self, n_joints: int) -> None:
        self._layout = ControlStateLayout(n_joints)

    def packed(self, trial: int, state: ArmState, tick: Tick) -> bytes:
        """Return the control state of one tick."""
        arrays = (
            tick.desired_position_rad.tolist(),
            tick.desired_velocity_rad_s.tolist(),
            tick.desired_acceleration_rad_s2.tolist(),
            tick.equilibrium_rad.tolist(),
            state.position_rad.tolist(),
            state.velocity_rad_s.tolist(),
            tick.effort_nm.tolist(),
        )
        return self._layout.packed(
            state.time_ns, trial, tick.phase, tick.time_from_start_s, arrays, tick.saturated.tolist()
        )
