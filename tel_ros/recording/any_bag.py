"""Opening bags that may be anybody's: rosbag1 or rosbag2, MCAP or sqlite3, with or without definitions."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from rosbags.highlevel import AnyReader
from rosbags.interfaces import Connection, ConnectionExtRosbag1, QosDurability

from tel_ros.core.errors import BagError, TelError
from tel_ros.recording.message_types import typestore

METADATA_FILE = "metadata.yaml"
_EXPECTED = "a closed rosbag2 folder, an .mcap, .db3 or .bag file"


@contextmanager
def open_any_bag(bag: Path) -> Iterator[AnyReader]:
    """Open a bag. Types that it does not define are those of ROS 2 Jazzy and our own.

    Raises:
        BagError: it is not there, was never closed, or cannot be read.
    """
    if not bag.exists():
        raise BagError(bag, "there is no such bag", _EXPECTED)
    if bag.is_dir() and not (bag / METADATA_FILE).is_file():
        raise BagError(bag, f"has no {METADATA_FILE}: it was never closed, or is no bag", _EXPECTED)
    with reading(bag):
        reader = AnyReader([bag], default_typestore=typestore())
        reader.open()
    try:
        yield reader
    finally:
        reader.close()


@contextmanager
def reading(bag: Path) -> Iterator[None]:
    """Make a BagError of whatever goes wrong with the bytes of a bag.

    Raises:
        BagError: damaged bytes make the reader and its libraries raise whatever they raise.
    """
    try:
        yield
    except TelError:
        raise
    except Exception as error:
        raise BagError(bag, f"cannot be read ({' '.join(str(error).split())})", _EXPECTED) from error


def is_latched(connection: Connection) -> bool:
    """Return whether a topic's newest message is to reach who comes late.

    That is how it was offered, where the bag tells; a single message in a whole bag would otherwise be missed
    by everybody who was not there at that moment.
    """
    if isinstance(connection.ext, ConnectionExtRosbag1):
        return connection.msgcount == 1 or bool(connection.ext.latching)
    offered = [qos.durability for qos in connection.ext.offered_qos_profiles]
    return connection.msgcount == 1 or QosDurability.TRANSIENT_LOCAL in offered


def type_hash(reader: AnyReader, connection: Connection) -> str:
    """Return the hash (RIHS01) of a topic's type as the bag defines it; empty if nobody knows."""
    try:
        return reader.typestore.hash_rihs01(connection.msgtype)
    except KeyError:
        return connection.digest
