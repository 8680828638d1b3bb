"""The three messages of the control loop, packed and read in one step each.

rclpy makes a Python object of every message and goes through it field by field, which costs about as much as
a control tick. The messages of one arm differ in their numbers alone: everything else, names and lengths,
makes up a layout that stays. So a layout is found once, and from then on :mod:`struct` does the work.

The bytes are CDR, little-endian, as ROS 2 sends them: two bytes tell the encoding, two have options that say
nothing about the content; numbers are aligned to their size, counted from behind these four bytes; texts and
sequences have their length in front, texts a zero byte at the end that counts.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

from tel_ros.core.types import NS_PER_S

LITTLE_ENDIAN_CDR = b"\x00\x01"
_NO_OPTIONS = b"\x00\x00"
_LONGEST_LABEL = 32
"""More than the digits of any stamp."""
_MOST_NAMES, _MOST_VALUES = 256, 4096


class JointStateNumbers(NamedTuple):
    """What differs from one joint state of an arm to the next."""

    stamp_ns: int
    position_rad: tuple[float, ...]
    velocity_rad_s: tuple[float, ...]
    effort_nm: tuple[float, ...]


class CommandNumbers(NamedTuple):
    """What differs from one command for an arm to the next."""

    label: bytes
    """Of the array's one dimension; empty: there is none."""
    values: tuple[float, ...]

    @property
    def answered_ns(self) -> int | None:
        """The stamp of the joint state that the command says it answers."""
        return int(self.label) if self.label.isdigit() else None


class _Format:
    """Builds the format of a layout, with the padding that CDR asks for."""

    def __init__(self) -> None:
        self._text, self._end = "<2s2s", 0
        self.constants: list[int | bytes] = []
        """Lengths and texts, in their order."""

    def numbers(self, code: str, count: int = 1) -> None:
        """Add numbers that may differ from message to message; ``code`` is that of :mod:`struct`."""
        size = struct.calcsize(f"<{code}")
        if count:
            self._text += f"{-self._end % size}x{count}{code}"
            self._end += -self._end % size + count * size

    def length(self, value: int) -> None:
        """Add the length of a sequence, or another constant of four bytes."""
        self.numbers("I")
        self.constants.append(value)

    def text(self, encoded: bytes) -> None:
        """Add a text that stays, without its zero byte."""
        self.length(len(encoded) + 1)
        self._text += f"{len(encoded) + 1}s"
        self._end += len(encoded) + 1
        self.constants.append(encoded + b"\0")

    def doubles(self, count: int) -> None:
        """Add a sequence of doubles."""
        self.length(count)
        self.numbers("d", count)

    def made(self) -> struct.Struct:
        """Return the format."""
        return struct.Struct(self._text)


class JointStateLayout:
    """``sensor_msgs/JointState`` of one arm.

    Args:
        names: of the joints.
        lengths: of position, velocity and effort.
        frame_id: of the header.
    """

    def __init__(self, names: Sequence[str], lengths: tuple[int, int, int], frame_id: str = "") -> None:
        self.names = tuple(names)
        parts = _Format()
        parts.numbers("i")
        parts.numbers("I")
        parts.text(frame_id.encode())
        parts.length(len(names))
        for name in names:
            parts.text(name.encode())
        # Behind the encoding and the two numbers of the stamp.
        self._prefix = tuple(parts.constants)
        first = 4 + len(self._prefix)
        spans = []
        for length in lengths:
            parts.doubles(length)
            spans.append(slice(first + 1, first + 1 + length))
            first += 1 + length
        self._spans = spans
        self._lengths = lengths
        self._format = parts.made()

    @classmethod
    def of(cls, raw: bytes) -> JointStateLayout | None:
        """Return the layout of a serialised message, or None if it cannot be told."""
        try:
            reader = _Reader(raw)
            reader.skip("i")
            reader.skip("I")
            frame_id = reader.text()
            names = [reader.text() for _ in range(reader.length(_MOST_NAMES))]
            position, velocity, effort = (reader.doubles() for _ in range(3))
        except (struct.error, ValueError):
            return None
        return cls(names, (position, velocity, effort), frame_id)

    def read(self, raw: bytes) -> JointStateNumbers | None:
        """Return the numbers of a serialised message, or None if it has another layout."""
        if len(raw) != self._format.size:
            return None
        fields = self._format.unpack(raw)
        position, velocity, effort = self._spans
        same = (
            fields[0] == LITTLE_ENDIAN_CDR
            and fields[4 : position.start - 1] == self._prefix
            and (fields[position.start - 1], fields[velocity.start - 1], fields[effort.start - 1])
            == self._lengths
        )
        if not same:
            return None
        stamp_ns = fields[2] * NS_PER_S + fields[3]
        return JointStateNumbers(stamp_ns, fields[position], fields[velocity], fields[effort])

    def packed(
        self,
        stamp_ns: int,
        position_rad: Sequence[float],
        velocity_rad_s: Sequence[float],
        effort_nm: Sequence[float],
    ) -> bytes:
        """Return a serialised message.

        Raises:
            struct.error: another number of values than the layout has.
        """
        position, velocity, effort = self._lengths
        return self._format.pack(
            LITTLE_ENDIAN_CDR,
            _NO_OPTIONS,
            *divmod(stamp_ns, NS_PER_S),
            *self._prefix,
            *(position, *position_rad),
            *(velocity, *velocity_rad_s),
            *(effort, *effort_nm),
        )


class CommandLayout:
    """``std_msgs/Float64MultiArray`` of one dimension, or of none, with a label of some length.

    Args:
        n_values: length of the data.
        n_label: length of the label in bytes; None: there is no dimension.
    """

    def __init__(self, n_values: int, n_label: int | None) -> None:
        self._n_values, self._n_label = n_values, n_label
        parts = _Format()
        parts.length(0 if n_label is None else 1)
        if n_label is not None:
            parts.text(bytes(n_label))
            parts.length(n_values)  # size
            parts.length(n_values)  # stride
        parts.length(0)  # data_offset
        parts.doubles(n_values)
        self._format = parts.made()
        self._first = 2 + len(parts.constants)

    @classmethod
    def of(cls, raw: bytes) -> CommandLayout | None:
        """Return the layout of a serialised message, or None if it cannot be told."""
        try:
            reader = _Reader(raw)
            n_dimensions, n_label = reader.length(1), None
            if n_dimensions:
                n_label = len(reader.text().encode())
                reader.skip("I")
                reader.skip("I")
            reader.skip("I")
            return cls(reader.doubles(), n_label)
        except (struct.error, ValueError):
            return None

    def read(self, raw: bytes) -> CommandNumbers | None:
        """Return what a serialised message says, or None if it has another layout."""
        if len(raw) != self._format.size:
            return None
        fields = self._format.unpack(raw)
        first, label = self._first, b""
        if fields[0] != LITTLE_ENDIAN_CDR or fields[first - 1] != self._n_values:
            return None
        if self._n_label is None:
            if fields[2] != 0:
                return None
        else:
            if fields[2:4] != (1, self._n_label + 1):
                return None
            label = fields[4][:-1]
        return CommandNumbers(label, fields[first:])

    def packed(self, label: bytes, values: Sequence[float]) -> bytes:
        """Return a serialised message.

        Raises:
            struct.error: another number of values than the layout has.
        """
        n = self._n_values
        return self._format.pack(
            LITTLE_ENDIAN_CDR, _NO_OPTIONS, 1, len(label) + 1, label + b"\0", n, n, 0, n, *values
        )


@lru_cache(maxsize=4 * _LONGEST_LABEL)
def command_layout(n_values: int, n_label: int) -> CommandLayout:
    """Return the layout of commands whose label has a length: stamps have more and more digits."""
    return CommandLayout(n_values, n_label)


class ControlStateLayout:
    """``tel_interfaces/ControlState`` of one arm.

    Args:
        n_joints: length of all its arrays.
    """

    ARRAYS = 7

    def __init__(self, n_joints: int) -> None:
        self._n_joints = n_joints
        parts = _Format()
        parts.numbers("i")
        parts.numbers("I")
        parts.text(b"")
        parts.numbers("I")  # trial
        parts.numbers("B")  # phase
        parts.numbers("d")  # time_from_start_s
        for _ in range(self.ARRAYS):
            parts.doubles(n_joints)
        parts.length(n_joints)
        parts.numbers("?", n_joints)
        self._format = parts.made()

    def packed(
        self,
        stamp_ns: int,
        trial: int,
        phase: int,
        time_from_start_s: float,
        arrays: Sequence[Sequence[float]],
        saturated: Sequence[bool],
    ) -> bytes:
        """Return a serialised message.

        Args:
            stamp_ns: of the header.
            trial: as in the message.
            phase: as in the message.
            time_from_start_s: as in the message.
            arrays: the seven arrays of doubles in the order of the message.
            saturated: the last array.

        Raises:
            struct.error: another number of values than the layout has.
        """
        n = self._n_joints
        position, velocity, acceleration, equilibrium, found, speed, effort = arrays
        return self._format.pack(
            LITTLE_ENDIAN_CDR,
            _NO_OPTIONS,
            *divmod(stamp_ns, NS_PER_S),
            *(1, b"\0", trial, phase, time_from_start_s),
            *(n, *position, n, *velocity, n, *acceleration, n, *equilibrium),
            *(n, *found, n, *speed, n, *effort, n, *saturated),
        )


class _Reader:
    """Goes through a serialised message from its beginning.

    Raises:
        ValueError: it has another encoding, or a length that cannot be.
        struct.error: it ends before its end.
    """

    def __init__(self, raw: bytes) -> None:
        if raw[:2] != LITTLE_ENDIAN_CDR:
            raise ValueError("another encoding")
        self._raw, self._place = raw, 4

    def skip(self, code: str, count: int = 1) -> None:
        """Pass over numbers."""
        size = struct.calcsize(f"<{code}")
        if count:
            self._place += -(self._place - 4) % size + count * size
        if self._place > len(self._raw):
            raise ValueError("the message ends too early")

    def length(self, most: int) -> int:
        """Return the length of what follows."""
        self.skip("I")
        (value,) = struct.unpack_from("<I", self._raw, self._place - 4)
        if value > most:
            raise ValueError(f"{value} is too many")
        return int(value)

    def text(self) -> str:
        """Return a text."""
        length = self.length(len(self._raw))
        encoded = self._raw[self._place : self._place + length]
        self.skip("s", length)
        if encoded[-1:] != b"\0":
            raise ValueError("a text without end")
        return encoded[:-1].decode()

    def doubles(self) -> int:
        """Pass over a sequence of doubles; return its length."""
        count = self.length(_MOST_VALUES)
        self.skip("d", count)
        return count
