"""Joint states on one time base, whether each message has all joints, half of the arm, or one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from tel_ros.core.errors import InputFileError, counted
from tel_ros.core.learning.joint_recording import JointRecording
from tel_ros.core.types import NS_PER_S, BoolArray, FloatArray, IntArray
from tel_ros.recording.cdr import time_ns

_LONGEST_GAP_S, _LONGEST_GAP = 0.025, 2.5
"""A joint is not interpolated across more than this and this many of its periods."""


@dataclass(frozen=True)
class Stamped:
    """A joint state, when it was recorded [ns], its joints' names, and which of them count; None: all."""

    recorded_ns: int
    message: Any
    names: tuple[str, ...]
    only: set[str] | None = None


def merged_states(source: str, messages: Sequence[Stamped], learned: Sequence[str]) -> JointRecording:
    """Return all joints at the times of that joint, of those to learn, which has the fewest messages.

    Messages without efforts do not count for a joint that has some with. Joints at other times are
    interpolated by a cubic spline; times that lie in a gap of one of them are left out.

    Raises:
        InputFileError: a message names a joint twice, or has another number of values than joints; stamps go
            back; or joints were never recorded at the same time.
    """
    fullest_first = sorted(messages, key=lambda each: -len(each.names))
    joints = tuple(dict.fromkeys(n for m in fullest_first for n in m.names if m.only is None or n in m.only))
    moments_ns = np.array([time_ns(m.message.header.stamp) for m in messages], dtype=np.int64)
    if not np.any(moments_ns):  # nobody has set the stamps
        moments_ns = np.array([m.recorded_ns for m in messages], dtype=np.int64)
    named, position_rad, effort_nm = _columns(source, messages, joints)
    tells = np.array([len(m.message.effort) > 0 for m in messages])
    rows = {}
    for j, joint in enumerate(joints):
        with_effort = named[:, j] & tells
        rows[joint] = np.flatnonzero(with_effort if with_effort.any() else named[:, j])
    joints_told = [joint for joint in joints if len(rows[joint])]
    base = rows[min(learned, key=lambda joint: len(rows[joint]))]
    if all(np.array_equal(rows[joint], base) for joint in joints):
        time_s = (moments_ns[base] - moments_ns[base[0]]) / NS_PER_S
        return JointRecording(source, joints, time_s, position_rad[base], effort_nm[base])
    merged = _merged(source, joints, learned, rows, base, moments_ns, (position_rad, effort_nm))
    return merged.of(joints_told)


def _columns(
    source: str, messages: Sequence[Stamped], joints: tuple[str, ...]
) -> tuple[BoolArray, FloatArray, FloatArray]:
    """Return which joints each message names, their positions and their efforts. Shape (n, n_joints)."""
    shape = len(messages), len(joints)
    named, values = np.zeros(shape, dtype=bool), [np.full(shape, np.nan) for _ in range(2)]
    places: dict[tuple[str, ...], tuple[list[int], list[int]]] = {}
    for k, each in enumerate(messages):
        if each.names not in places:
            if repeated := sorted({name for name in each.names if each.names.count(name) > 1}):
                found = f"message {k + 1} names {', '.join(repeated)} twice"
                raise InputFileError(source, found, "each joint once in a message")
            taken = [i for i, name in enumerate(each.names) if each.only is None or name in each.only]
            places[each.names] = taken, [joints.index(each.names[i]) for i in taken]
        taken, columns = places[each.names]
        for field, array in zip(("position", "effort"), values, strict=True):
            told = getattr(each.message, field)
            if len(told) != len(each.names) and len(each.message.effort):
                found = f"message {k + 1} has {counted(len(told), 'value')} in {field}"
                raise InputFileError(source, found, f"one for each of its {len(each.names)} joints")
            if len(told) == len(each.names):
                array[k, columns] = np.asarray(told)[taken]
        named[k, columns] = len(each.message.position) == len(each.names)
    return named, values[0], values[1]


def _merged(
    source: str,
    joints: tuple[str, ...],
    learned: Sequence[str],
    rows: dict[str, IntArray],
    base: IntArray,
    moments_ns: IntArray,
    values: tuple[FloatArray, FloatArray],
) -> JointRecording:
    at_ns = moments_ns[base]
    merged, kept = (
        [np.full((len(base), len(joints)), np.nan) for _ in range(2)],
        np.ones(len(base), dtype=bool),
    )
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
    longest_s = (
        max(_LONGEST_GAP * float(np.median(np.diff(time_s))), _LONGEST_GAP_S) if len(time_s) > 1 else 0.0
    )
    after = np.searchsorted(time_s, at_s)
    exact = time_s[np.minimum(after, len(time_s) - 1)] == at_s
    inside = (after > 0) & (after < len(time_s))
    gap_s = time_s[np.minimum(after, len(time_s) - 1)] - time_s[np.maximum(after - 1, 0)]
    between: BoolArray = exact | (inside & (gap_s <= longest_s))
    return between
