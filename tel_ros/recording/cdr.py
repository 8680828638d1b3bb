"""Messages as bytes: those of the control loop packed and read in one step, single fields of others.

rclpy goes through every message field by field, which costs about as much as a control tick. The messages of
one arm differ in their numbers alone; names and lengths make up a layout that stays. So a layout is found
once, and from then on :mod:`struct` does the work.

The bytes are CDR: two tell the encoding (and with it the byte order), two have options that say nothing about
the content; numbers are aligned to their size, counted from behind these four bytes; texts and sequences have
their length in front, texts a zero byte at the end that counts.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from functools import lru_cache
from operator import itemgetter
from typing import Any, NamedTuple

from tel_ros.core.arm_state import ArmState
from tel_ros.core.trial import Tick
from tel_ros.core.types import NS_PER_S, FloatArray

LITTLE_ENDIAN_CDR = b"\x00\x01"
_HEADER_BYTES = 4
_MOST_NAMES, _MOST_VALUES, _LONGEST_TEXT = 256, 4096, 4096


def time_ns(stamp: Any) -> int:
    """Return a time or duration, as a message or read from a bag, in nanoseconds."""
    return int(stamp.sec) * NS_PER_S + int(stamp.nanosec)


class JointStateNumbers(NamedTuple):
    """What a joint state says."""

    names: Sequence[str]
    stamp_ns: int
    position_rad: Sequence[float]
    velocity_rad_s: Sequence[float]
    effort_nm: Sequence[float]


class CommandNumbers(NamedTuple):
    """What a command says."""

    label: bytes
    """Of the array's one dimension; empty: there is none."""
    values: Sequence[float]

    @property
    def answered_ns(self) -> int | None:
        """The stamp of the joint state that the command says it answers."""
        return int(self.label) if self.label.isdigit() else None


class _Layout:
    """The layout of a little-endian message, field by field: which stay, and where those are that change.

    With the bytes of a message (``raw``), lengths and texts that stay are read from these. ValueError,
    struct.error: it has another encoding, an impossible length, or ends too early.
    """

    def __init__(self, raw: bytes | None = None) -> None:
        if raw is not None and raw[:2] != LITTLE_ENDIAN_CDR:
            raise ValueError("another encoding")
        self._raw, self._text, self._end = raw, "<2s2s", 0
        self._template: list[Any] = [LITTLE_ENDIAN_CDR, b"\x00\x00"]
        self._fixed, self._changing = [0], list[slice]()

    def changing(self, code: str, count: int = 1) -> None:
        """Add numbers that change; ``code`` is that of :mod:`struct`."""
        self._changing.append(slice(len(self._template), len(self._template) + count))
        size = struct.calcsize(f"<{code}")
        if count:
            self._text += f"{-self._end % size}x{count}{code}"
            self._end += -self._end % size + count * size
        self._template += [0] * count

    def header(self) -> None:
        """Add a ``std_msgs/Header`` without a ``frame_id``."""
        self.changing("i")
        self.changing("I")
        self.text("")

    def length(self, value: int, most: int) -> int:
        """Add a length that stays, and return it."""
        self.changing("I")
        self._changing.pop()
        if self._raw is not None:
            (value,) = struct.unpack_from("<I", self._raw, self._end + _HEADER_BYTES - 4)
        if value > most:
            raise ValueError(f"{value} is too many")
        self._fixed.append(len(self._template) - 1)
        self._template[-1] = value
        return value

    def text(self, value: str, changes: bool = False) -> str:
        """Add a text, and return it."""
        encoded = value.encode() + b"\0"
        n = self.length(len(encoded), _LONGEST_TEXT)
        if self._raw is not None:
            encoded = self._raw[self._end + _HEADER_BYTES :][:n]
            if len(encoded) != n or encoded[-1:] != b"\0":
                raise ValueError("a text without end")
        self._text += f"{n}s"
        self._end += n
        place = len(self._template)
        self._template.append(encoded)
        if changes:
            self._changing.append(slice(place, place + 1))
        else:
            self._fixed.append(place)
        return encoded[:-1].decode()

    def sequence(self, count: int, code: str = "d") -> None:
        """Add a sequence of numbers that change."""
        self.changing(code, self.length(count, _MOST_VALUES))

    def finish(self) -> None:
        """Make the format."""
        self._format = struct.Struct(self._text)
        if self._raw is not None and len(self._raw) < self._format.size:
            raise ValueError("the message ends too early")
        self._raw = None
        self._pick = itemgetter(*self._fixed)
        self._expected = self._pick(self._template)
        ends = [0, *(place.stop for place in self._changing)]
        starts = [place.start for place in self._changing]
        self._before = [self._template[end:start] for end, start in zip(ends, starts, strict=False)]

    def fields(self, raw: bytes) -> list[Any] | None:
        """Return what changes, or None if a message has another layout."""
        if len(raw) != self._format.size:
            return None
        fields = self._format.unpack(raw)
        if self._pick(fields) != self._expected:
            return None
        return [fields[place] for place in self._changing]

    def pack(self, *changing: Sequence[Any]) -> bytes:
        """Return a message; struct.error: another number of values than the layout has."""
        fields: list[Any] = []
        for before, values in zip(self._before, changing, strict=True):
            fields += before
            fields += values
        return self._format.pack(*fields)


class JointStateLayout(_Layout):
    """``sensor_msgs/JointState`` of one arm; ``lengths`` of position, velocity and effort."""

    def __init__(
        self, names: Sequence[str] = (), lengths: Sequence[int] = (0, 0, 0), raw: bytes | None = None
    ) -> None:
        super().__init__(raw)
        self.header()
        n = self.length(len(names), _MOST_NAMES)
        self.names = tuple(self.text(names[k] if raw is None else "") for k in range(n))
        for length in lengths:
            self.sequence(length)
        self.finish()

    def read(self, raw: bytes) -> JointStateNumbers | None:
        """Return what a message says, or None if it has another layout."""
        found = self.fields(raw)
        if found is None:
            return None
        (seconds,), (nanoseconds,), position, velocity, effort = found
        return JointStateNumbers(self.names, seconds * NS_PER_S + nanoseconds, position, velocity, effort)

    def packed(self, stamp_ns: int, *arrays: Sequence[float]) -> bytes:
        """Return a message with positions, velocities and efforts."""
        seconds, nanoseconds = divmod(stamp_ns, NS_PER_S)
        return self.pack((seconds,), (nanoseconds,), *arrays)


class CommandLayout(_Layout):
    """``std_msgs/Float64MultiArray`` of one dimension with a label of this length; None: of no dimension."""

    def __init__(self, n_values: int = 0, label: str | None = None, raw: bytes | None = None) -> None:
        super().__init__(raw)
        self._has_label = self.length(0 if label is None else 1, 1) == 1
        if self._has_label:
            self.text(label or "", changes=True)
            self.changing("I", 2)  # size, stride
        self.changing("I")  # data_offset
        self.sequence(n_values)
        self.finish()

    def read(self, raw: bytes) -> CommandNumbers | None:
        """Return what a message says, or None if it has another layout."""
        found = self.fields(raw)
        if found is None:
            return None
        return CommandNumbers(found[0][0][:-1] if self._has_label else b"", found[-1])


@lru_cache(maxsize=128)
def _command_layout(n_values: int, n_label: int) -> CommandLayout:
    return CommandLayout(n_values, "0" * n_label)


def packed_command(label: str, values: FloatArray) -> bytes:
    """Return a command: efforts or equilibrium points, shape (n_joints,), marked with a label.

    The label is the stamp in ns of the joint state that it answers, for the simulated arm in lockstep and the
    recorder (stock controllers do not look at it); or the name of a node that commands without answering.
    """
    encoded, n = label.encode(), len(values)
    return _command_layout(n, len(encoded)).pack((encoded + b"\0",), (n, n), (0,), values.tolist())


class ControlStateLayout(_Layout):
    """``tel_interfaces/ControlState`` of one arm."""

    def __init__(self, n_joints: int) -> None:
        super().__init__()
        self.header()
        for code in "IBd":  # trial, phase, time_from_start_s
            self.changing(code)
        for _ in range(7):
            self.sequence(n_joints)
        self.sequence(n_joints, "?")
        self.finish()

    def packed(self, trial: int, state: ArmState, tick: Tick) -> bytes:
        """Return the control state of one tick."""
        seconds, nanoseconds = divmod(state.time_ns, NS_PER_S)
        return self.pack(
            (seconds,),
            (nanoseconds,),
            (trial,),
            (tick.phase,),
            (tick.time_from_start_s,),
            tick.desired_position_rad.tolist(),
            tick.desired_velocity_rad_s.tolist(),
            tick.desired_acceleration_rad_s2.tolist(),
            tick.equilibrium_rad.tolist(),
            state.position_rad.tolist(),
            state.velocity_rad_s.tolist(),
            tick.effort_nm.tolist(),
            tick.saturated.tolist(),
        )


class ControllerStateLayout(_Layout):
    """``control_msgs/JointTrajectoryControllerState`` of one arm whose command is an effort."""

    def __init__(self, joints: Sequence[str]) -> None:
        super().__init__()
        n = len(joints)
        self.header()
        self.length(n, _MOST_NAMES)
        for joint in joints:
            self.text(joint)
        # How many positions, velocities, accelerations and efforts: reference, feedback, error, output.
        for lengths in ((n, n, n, 0), (n, n, 0, 0), (n, n, 0, 0), (0, 0, 0, n)):
            for length in lengths:
                self.sequence(length)
            self.changing("i")
            self.changing("I")
        # No joints of several degrees of freedom: no names, and of each of four points three empty sequences
        # and no time.
        for _ in range(1 + 4 * 5):
            self.length(0, 0)
        self.changing("d")
        self.finish()

    def packed(self, stamp_ns: int, since_ns: int, *rows: Sequence[float]) -> bytes:
        """Return a message; ``since_ns``: from the start of the trajectory.

        ``rows``: reference (position, velocity, acceleration), feedback, error (position, velocity), effort.
        """
        stamp, since, zero = ([(part,) for part in divmod(ns, NS_PER_S)] for ns in (stamp_ns, since_ns, 0))
        y, dy, ddy, q, dq, e, de, effort = rows
        reference, feedback = (y, dy, ddy, (), *since), (q, dq, (), (), *since)
        error, output = (e, de, (), (), *zero), ((), (), (), effort, *zero)
        return self.pack(*stamp, *reference, *feedback, *error, *output, (1.0,))


def message_reader(kind: type[Any], otherwise: Callable[[bytes], Any]) -> Callable[[bytes], Any]:
    """Return a reader of messages, most of which have the layout (of class ``kind``) of the one before.

    Others are read by ``otherwise``: a driver may dress its messages as it likes.
    """
    layout: Any = None

    def read(raw: bytes) -> Any:
        nonlocal layout
        numbers = layout.read(raw) if layout is not None else None
        if numbers is None:
            try:
                layout = kind(raw=raw)
                numbers = layout.read(raw)
            except (struct.error, ValueError):
                layout = None
        return otherwise(raw) if numbers is None else numbers

    return read


def header_stamp_ns(serialised: bytes) -> int:
    """Return the stamp of a serialised message that begins with a header."""
    seconds, nanoseconds = _ORDERS[serialised[1] & 1][0].unpack_from(serialised, _HEADER_BYTES)
    return int(seconds) * NS_PER_S + int(nanoseconds)


def trial_index(serialised: bytes) -> int:
    """Return the trial that a serialised control state belongs to: the number behind its header."""
    number = _ORDERS[serialised[1] & 1][1]
    (frame_id_length,) = number.unpack_from(serialised, _HEADER_BYTES + 8)
    (index,) = number.unpack_from(serialised, _aligned(_HEADER_BYTES + 12 + frame_id_length))
    return int(index)


def answered_ns(serialised: bytes) -> int | None:
    """Return the stamp of the state that a serialised command answers; None: it does not say."""
    number = _ORDERS[serialised[1] & 1][1]
    (n_dimensions,) = number.unpack_from(serialised, _HEADER_BYTES)
    place = _HEADER_BYTES + 4
    for _ in range(n_dimensions):
        (length,) = number.unpack_from(serialised, place)
        label = serialised[place + 4 : place + 4 + length].rstrip(b"\0")
        if label.isdigit():
            return int(label)
        place = _aligned(place + 4 + length) + 8  # size and stride
    return None


# Stamp and number by the message's second byte: big-endian, little-endian. Made once: the module would look
# each up by its text.
_ORDERS = [(struct.Struct(f"{order}iI"), struct.Struct(f"{order}I")) for order in "><"]


def _aligned(place: int) -> int:
    """Return the next place for a number of four bytes; the header has four as well."""
    return place + -place % 4
