"""Joint states as arrays: as they are, or on one time base, whether messages have all joints or only some."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.interfaces import Connection
from scipy.interpolate import CubicSpline

from tel_ros.core.errors import BagError, InputFileError, counted
from tel_ros.core.learning.joint_recording import JointRecording
from tel_ros.core.types import NS_PER_S, BoolArray, FloatArray, IntArray
from tel_ros.recording.any_bag import AnyBag, open_any_bag, reading
from tel_ros.recording.cdr import time_ns
from tel_ros.recording.topics import JOINT_STATE

_LONGEST_GAP_S, _LONGEST_GAP = 0.025, 2.5
"""A joint is not interpolated across more than this and this many of its periods."""


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


@dataclass(frozen=True)
class Stamped:
    """A joint state, when it was recorded [ns], and its joints' names; empty: one that does not count."""

    recorded_ns: int
    message: Any
    names: tuple[str, ...]


def merged_states(source: str, stamped: Sequence[Stamped], learned: Sequence[str]) -> JointRecording:
    """Return all joints at the times of that joint, of those to learn, which has the fewest messages.

    Messages without efforts do not count for a joint that has some with. Joints at other times are
    interpolated by a cubic spline; times that lie in a gap of one of them are left out. InputFileError: a
    message names a joint twice, or has another number of values than joints; stamps go back; or joints were
    never recorded together.
    """
    messages, names = [each.message for each in stamped], [each.names for each in stamped]
    fullest_first = sorted(names, key=len, reverse=True)
    joints = tuple(dict.fromkeys(name for each in fullest_first for name in each if name))
    _require_lengths(source, messages, names)
    moments_ns = np.array([time_ns(message.header.stamp) for message in messages], dtype=np.int64)
    if not np.any(moments_ns):  # nobody has set the stamps
        moments_ns = np.array([each.recorded_ns for each in stamped], dtype=np.int64)
    tells = np.array([len(message.effort) > 0 for message in messages])
    values = [columns(messages, names, joints, field) for field in ("position", "effort")]
    placed = np.array([len(message.position) > 0 for message in messages])
    rows = {}
    for joint in joints:
        named = placed & np.array([joint in each for each in names])
        rows[joint] = np.flatnonzero(named & tells if np.any(named & tells) else named)
    told = [joint for joint in joints if len(rows[joint])]
    base = rows[min(learned, key=lambda joint: len(rows[joint]))]
    if all(np.array_equal(rows[joint], base) for joint in joints):
        time_s = (moments_ns[base] - moments_ns[base[0]]) / NS_PER_S
        return JointRecording(source, joints, time_s, values[0][base], values[1][base])
    return _merged(source, joints, learned, rows, base, moments_ns, values).of(told)


def _require_lengths(source: str, messages: Sequence[Any], names: Sequence[tuple[str, ...]]) -> None:
    for k, (message, named) in enumerate(zip(messages, names, strict=True)):
        if repeated := sorted({name for name in named if name and named.count(name) > 1}):
            found = f"message {k + 1} names {', '.join(repeated)} twice"
            raise InputFileError(source, found, "each joint once in a message")
        for field in ("position", "effort") if len(message.effort) else ():
            if (n := len(getattr(message, field))) != len(named):
                found = f"message {k + 1} has {counted(n, 'value')} in {field}"
                raise InputFileError(source, found, f"one for each of its {len(named)} joints")


def _merged(
    source: str,
    joints: tuple[str, ...],
    learned: Sequence[str],
    rows: dict[str, IntArray],
    base: IntArray,
    moments_ns: IntArray,
    values: Sequence[FloatArray],
) -> JointRecording:
    at_ns, kept = moments_ns[base], np.ones(len(base), dtype=bool)
    merged = np.full((2, len(base), len(joints)), np.nan)
    for j, joint in enumerate(joints):
        own_ns, first = np.unique(moments_ns[rows[joint]], return_index=True)
        if np.any(np.diff(moments_ns[rows[joint]]) < 0):
            raise InputFileError(source, f"the stamps of {joint} go back", "stamps in the order of time")
        if not len(own_ns):
            continue
        time_s, at_s = (own_ns - own_ns[0]) / NS_PER_S, (at_ns - own_ns[0]) / NS_PER_S
        for array, out in zip(values, merged, strict=True):
            column = array[rows[joint][first], j]
            if joint in learned and len(own_ns) > 1 and np.isfinite(column).all():
                out[:, j] = CubicSpline(time_s, column)(at_s)
            else:
                out[:, j] = np.interp(at_s, time_s, column)
        if joint in learned:
            kept &= _has_neighbours(time_s, at_s)
    if not kept.any():
        raise InputFileError(
            source, f"never tells {', '.join(learned)} at about the same time", "joints of one arm in motion"
        )
    time_s = (at_ns[kept] - at_ns[kept][0]) / NS_PER_S
    return JointRecording(source, joints, time_s, merged[0][kept], merged[1][kept])


def _has_neighbours(time_s: FloatArray, at_s: FloatArray) -> BoolArray:
    """Return which times lie between two samples that are close enough to interpolate, or on one."""
    period_s = float(np.median(np.diff(time_s))) if len(time_s) > 1 else 0.0
    after = np.searchsorted(time_s, at_s)
    next_s, last_s = time_s[np.minimum(after, len(time_s) - 1)], time_s[np.maximum(after - 1, 0)]
    inside = (after > 0) & (after < len(time_s))
    near = next_s - last_s <= max(_LONGEST_GAP * period_s, _LONGEST_GAP_S)
    between: BoolArray = (next_s == at_s) | (inside & near)
    return between
