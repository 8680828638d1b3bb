"""What bags are made of: types of messages, quality of service; and opening bags that may be anybody's."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from rosbags.highlevel import AnyReader
from rosbags.interfaces import (
    Connection,
    ConnectionExtRosbag1,
    Nodetype,
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from tel_ros.core.errors import BagError, TelError, counted
from tel_ros.recording import topics
from tel_ros.recording.shared_files import share_folder

METADATA_FILE = "metadata.yaml"
_OURS = ("ControlState", "TrialGoal", "TrialResult")
_EXPECTED = "a closed rosbag2 folder, an .mcap, .db3 or .bag file"
_DEPTH = 10
_INFINITE = QosTime(9223372036, 854775807)
"""The longest time that rosbag2 can tell: no deadline, no lifespan, no lease."""


@cache
def typestore() -> Typestore:
    """Return the types of ROS 2 Jazzy together with those of ``tel_interfaces``, as installed.

    Only writing needs it: a bag carries its definitions.
    """
    store = get_typestore(Stores.ROS2_JAZZY)
    folder = share_folder("tel_interfaces") / "msg"
    for name in _OURS:
        text = (folder / f"{name}.msg").read_text(encoding="utf-8")
        store.register(get_types_from_msg(text, f"tel_interfaces/msg/{name}"))
    return store


def to_cdr(name: str, message: Any) -> bytes:
    """Return a message of flat fields, arrays of them and other messages in the form that bags hold.

    ROS's own serialisation adds stray bytes after an empty array of doubles, and readers of bags then refuse
    the message.

    Args:
        name: of its type, e.g. ``tel_interfaces/msg/TrialGoal``.
        message: anything with the fields of that type.
    """
    return bytes(typestore().serialize_cdr(_record(name, message), name))


def _record(name: str, message: Any) -> Any:
    store = typestore()
    _, fields = store.fielddefs[name]
    return store.types[name](**{key: _value(kind, getattr(message, key)) for key, kind in fields})


def _value(kind: Any, value: Any) -> Any:
    nodetype, of = kind
    if nodetype == Nodetype.NAME:
        return _record(of, value)
    if nodetype == Nodetype.BASE:
        return value
    (_, (element, _)), _ = of
    return list(value) if element == "string" else np.array(value, dtype=element)


def offered_qos(topic: str, *, latched: bool = False) -> Qos:
    """Return the quality of service for playing a topic of a trial: reliable, as it was published.

    What a trial has once is latched in any case.
    """
    once = latched or any(topics.is_named(topic, name) for name in topics.RECORDED_ONCE)
    return Qos(
        history=QosHistory.KEEP_LAST,
        depth=1 if once else _DEPTH,
        reliability=QosReliability.RELIABLE,
        durability=QosDurability.TRANSIENT_LOCAL if once else QosDurability.VOLATILE,
        deadline=_INFINITE,
        lifespan=_INFINITE,
        liveliness=QosLiveliness.AUTOMATIC,
        liveliness_lease_duration=_INFINITE,
        avoid_ros_namespace_conventions=False,
    )


def bag_information(bag: Path) -> dict[str, Any]:
    """Return what ``metadata.yaml`` says; raises whatever a damaged file makes the libraries raise."""
    text = (bag / METADATA_FILE).read_text(encoding="utf-8")
    information: dict[str, Any] = yaml.safe_load(text)["rosbag2_bagfile_information"]
    return information


def all_messages(bag: Path, reader: AnyReader, connections: Sequence[Connection]) -> list[tuple[int, Any]]:
    """Return time [ns] and content of the messages of one topic; BagError if not all announced ones come."""
    found = [
        (time_ns, reader.deserialize(raw, c.msgtype)) for c, time_ns, raw in reader.messages(connections)
    ]
    announced = sum(connection.msgcount for connection in connections)
    if len(found) != announced:
        what = f"yields {counted(len(found), 'message')} of {connections[0].topic}"
        raise BagError(bag, what, f"the {announced} that it announces")
    return found


@contextmanager
def open_any_bag(bag: Path) -> Iterator[AnyReader]:
    """Open a bag; BagError if it is not there, was never closed, or cannot be read.

    Types that it does not define are those of ROS 2 Jazzy and our own.
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
def reading(bag: Path, expected: str = _EXPECTED) -> Iterator[None]:
    """Make a BagError of whatever damaged bytes make the reader and its libraries raise."""
    try:
        yield
    except TelError:
        raise
    except Exception as error:
        text = " ".join(str(error).split())
        # A library's own errors speak for themselves; the text of a KeyError, say, needs its kind.
        kind = "" if type(error).__module__ != "builtins" else f"{type(error).__name__}: "
        raise BagError(bag, f"cannot be read ({kind}{text})", expected) from error


def is_latched(connection: Connection) -> bool:
    """Return whether late joiners are to get a topic's newest message: as offered, or if it has only one."""
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
