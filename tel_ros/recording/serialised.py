"""Single fields of serialised messages, read where they lie: the recorder has no time to make objects of all.

CDR: four bytes tell the encoding, and with it the byte order; numbers are aligned to their size, counted from
behind these four bytes; texts have their length, zero byte included, in front.
"""

from __future__ import annotations

import struct

from tel_ros.core.types import NS_PER_S

_ENCODING_BYTES = 4
# Made once: the module would look each of them up by its text.
_STAMP, _STAMP_BIG_ENDIAN = struct.Struct("<iI"), struct.Struct(">iI")
_NUMBER, _NUMBER_BIG_ENDIAN = struct.Struct("<I"), struct.Struct(">I")


def header_stamp_ns(serialised: bytes) -> int:
    """Return the stamp of a serialised message that begins with a header."""
    stamp = _STAMP if serialised[1] & 1 else _STAMP_BIG_ENDIAN
    seconds, nanoseconds = stamp.unpack_from(serialised, _ENCODING_BYTES)
    return int(seconds) * NS_PER_S + int(nanoseconds)


def trial_index(serialised: bytes) -> int:
    """Return the trial that a serialised control state belongs to: the number behind its header."""
    number = _number(serialised)
    (frame_id_length,) = number.unpack_from(serialised, _ENCODING_BYTES + 8)
    (index,) = number.unpack_from(serialised, _aligned(_ENCODING_BYTES + 12 + frame_id_length))
    return int(index)


def answered_ns(serialised: bytes) -> int | None:
    """Return the stamp of the joint state that a serialised ``Float64MultiArray`` answers.

    It is the label of a dimension, in decimal digits; None if the command does not say.
    """
    number = _number(serialised)
    (n_dimensions,) = number.unpack_from(serialised, _ENCODING_BYTES)
    place = _ENCODING_BYTES + 4
    for _ in range(n_dimensions):
        (length,) = number.unpack_from(serialised, place)
        label = serialised[place + 4 : place + 4 + length].rstrip(b"\0")
        if label.isdigit():
            return int(label)
        place = _aligned(place + 4 + length) + 8  # size and stride
    return None


def _number(serialised: bytes) -> struct.Struct:
    return _NUMBER if serialised[1] & 1 else _NUMBER_BIG_ENDIAN


def _aligned(place: int) -> int:
    """Return the next place for a number of four bytes; that of the encoding are four as well."""
    return place + -place % 4
