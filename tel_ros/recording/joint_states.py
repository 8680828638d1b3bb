"""Joint states as arrays, from a bag of whatever arm."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.interfaces import Connection

from tel_ros.core.errors import BagError
from tel_ros.core.types import NS_PER_S, FloatArray
from tel_ros.recording.any_bag import AnyBag, open_any_bag, reading
from tel_ros.recording.cdr import time_ns
from tel_ros.recording.topics import JOINT_STATE


@dataclass(frozen=True)
class RecordedStates:
    """Joint states of a topic, one row a message and one column a joint; NaN where a message does not tell.

    ``joints``: in the order in which they first appear. ``time_s``: since the first message, by the headers'
    stamps if these go forward, else by the time of recording; shape (n,).
    """

    topic: str
    joints: tuple[str, ...]
    time_s: FloatArray
    position_rad: FloatArray
    velocity_rad_s: FloatArray
    effort_nm: FloatArray


def read_joint_states(bag: Path, topic: str = "") -> RecordedStates:
    """Read all joint states of a topic, or of the only one; BagError if there is none, or several."""
    with open_any_bag(bag) as reader, reading(bag):
        connections = _connections(reader, topic)
        read = [(at, reader.deserialize(raw, JOINT_STATE)) for _, at, raw in reader.messages(connections)]
    if not read:
        raise BagError(bag, f"yields no message of {connections[0].topic}", "joint states")
    recorded_ns, messages = zip(*read, strict=True)
    joints = tuple(dict.fromkeys(name for message in messages for name in message.name))
    if not joints:
        raise BagError(bag, f"names no joint in {connections[0].topic}", "joint states with names")
    stamps_ns = [time_ns(message.header.stamp) for message in messages]
    goes_forward = bool(np.all(np.diff(stamps_ns) > 0))
    moments_ns = np.array(stamps_ns if goes_forward else recorded_ns, dtype=np.int64)
    names = [message.name for message in messages]
    told = [columns(messages, names, joints, field) for field in ("position", "velocity", "effort")]
    return RecordedStates(connections[0].topic, joints, (moments_ns - moments_ns[0]) / NS_PER_S, *told)


def _connections(reader: AnyBag, topic: str) -> list[Connection]:
    of_states = [c for c in reader.connections if c.msgtype == JOINT_STATE and c.msgcount]
    names = sorted({connection.topic for connection in of_states})
    listed = ", ".join(names) or "none"
    if topic and topic not in names:
        expected = f"one of its topics of that type: {listed}"
        raise BagError(reader.bag, f"has no joint states on {topic}", expected)
    if not topic and len(names) != 1:
        found = f"has these topics of joint states: {listed}"
        raise BagError(reader.bag, found, "one, or the option --topic")
    return [connection for connection in of_states if connection.topic == (topic or names[0])]


def columns(
    messages: Sequence[Any], names: Sequence[Sequence[str]], joints: Sequence[str], field: str
) -> FloatArray:
    """Return a field, one row a message and one column a joint; NaN where a message does not tell."""
    values = np.full((len(messages), len(joints)), np.nan)
    place, places = {joint: k for k, joint in enumerate(joints)}, dict[tuple[str, ...], Any]()
    for row, message, named in zip(values, messages, map(tuple, names), strict=True):
        if named not in places:
            taken = [i for i, name in enumerate(named) if name in place]
            places[named] = taken, [place[named[i]] for i in taken]
        taken, where = places[named]
        told = getattr(message, field)
        if len(told) == len(named):  # empty where the arm does not tell
            row[where] = np.asarray(told)[taken]
    return values
