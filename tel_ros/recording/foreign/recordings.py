"""Joint recordings from CSVs and bags: rosbag1, rosbag2 in sqlite3 or MCAP, with or without metadata.yaml.

Two messages are understood: ``sensor_msgs/JointState`` with efforts, and ``trajectory_msgs/JointTrajectory``
whose points have efforts; each of the latter is a recording by itself. Types that a bag does not describe are
those of ROS 2 Jazzy.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.highlevel import AnyReader

from tel_ros.core.errors import InputFileError, counted
from tel_ros.core.learning.joint_recording import JointRecording
from tel_ros.core.types import NS_PER_S, FloatArray
from tel_ros.recording.bag_format import METADATA_FILE, all_messages, reading, typestore
from tel_ros.recording.cdr import time_ns
from tel_ros.recording.foreign.csv_files import read_csv_recording
from tel_ros.recording.topics import JOINT_STATE

JOINT_TRAJECTORY = "trajectory_msgs/msg/JointTrajectory"
DATA_FILES = (".mcap", ".db3")
BAG_FILES = (".bag", *DATA_FILES)
_EXPECTED = "a bag with sensor_msgs/JointState or trajectory_msgs/JointTrajectory with efforts"


def read_source(source: Path, topic: str = "", joints: Sequence[str] = ()) -> list[JointRecording]:
    """Read a bag or a CSV: see :func:`read_bag` and :func:`.csv_files.read_csv_recording`."""
    if source.suffix.lower() == ".csv":
        return [read_csv_recording(source, joints)]
    if source.is_file() and source.suffix not in BAG_FILES:
        expected = f"a folder of rosbag2, or a file {', '.join((*BAG_FILES, '.csv'))}"
        raise InputFileError(source, f"is a file {source.suffix or 'without an ending'}", expected)
    return read_bag(source, topic, joints)


def read_sources(
    sources: Sequence[Path], topic: str = "", joints: Sequence[str] = ()
) -> tuple[list[JointRecording], dict[str, tuple[float, float]]]:
    """Read recordings of one arm.

    Args:
        sources: bags and CSVs.
        topic: of bags; empty: the one that has efforts.
        joints: to learn, in this order; empty: all whose efforts the first source tells.

    Returns:
        Recordings of these joints, each fit to be learned from; and within which positions other joints
        stayed, by name.

    Raises:
        InputFileError: a source cannot be used, lacks a joint, or tells other joints than the first one.
    """
    found = [recording for source in sources for recording in read_source(source, topic, joints)]
    joints = tuple(joints) or found[0].with_effort() or found[0].joints
    for recording in found:
        extra = [joint for joint in recording.with_effort() if joint not in found[0].joints]
        if extra:
            expected = f"the joints of {found[0].source}: {', '.join(found[0].joints)}"
            raise InputFileError(recording.source, f"has the joints {', '.join(extra)}", expected)
    chosen = [recording.of(joints) for recording in found]
    for recording in chosen:
        recording.require_learnable()
    others: dict[str, tuple[float, float]] = {}
    for recording in found:
        for joint, (low, high) in recording.ranges_rad().items():
            if joint not in joints:
                least, most = others.get(joint, (low, high))
                others[joint] = (min(least, low), max(most, high))
    return chosen, others


def read_bag(bag: Path, topic: str = "", joints: Sequence[str] = ()) -> list[JointRecording]:
    """Read what a bag tells of joints and their efforts.

    Args:
        bag: a rosbag1 file, a folder of rosbag2, or one of its data files.
        topic: to read; empty: the one topic that has efforts.
        joints: that are wanted; empty: those of most messages. Messages without them are passed over.

    Returns:
        One recording for a topic of joint states, with all joints that its messages name; one for each
        message of a topic of trajectories.

    Raises:
        InputFileError: the bag cannot be used, has no such topic or several to choose from, or no efforts.
    """
    files = _files(bag)
    with reading(bag, _EXPECTED), AnyReader(files, default_typestore=typestore()) as reader:
        for fmt in {getattr(c.ext, "serialization_format", "cdr") for c in reader.connections} - {"cdr"}:
            raise InputFileError(bag, f"is serialised as {fmt!r}", "messages serialised as 'cdr'")
        named = {c.topic: c.msgtype for c in reader.connections}
        if topic and named.get(topic) not in (JOINT_STATE, JOINT_TRAJECTORY):
            found = f"{topic} has messages {named[topic]}" if topic in named else f"has no topic {topic}"
            raise InputFileError(bag, found, f"a topic of joints (it has {_list(named)})")
        of_joints = [t for t, kind in named.items() if kind in (JOINT_STATE, JOINT_TRAJECTORY)]
        topics = [topic] if topic else of_joints
        if not topics:
            raise InputFileError(bag, f"has the topics {_list(named) or 'of no messages'}", _EXPECTED)
        read = {
            t: _Messages(
                bag, t, named[t], all_messages(bag, reader, [c for c in reader.connections if c.topic == t])
            )
            for t in sorted(topics)
        }
    if not any(m.stamped for m in read.values()):
        raise InputFileError(bag, f"has no messages on {', '.join(read)}: it is empty", _EXPECTED)
    with_effort = {t: m for t, m in read.items() if m.has_effort(joints)}
    if not with_effort:
        found = f"tells no effort on {', '.join(read)}" + (f" for {', '.join(joints)}" if joints else "")
        raise InputFileError(bag, found, "efforts in N·m: what the torque is learned from")
    if len(with_effort) > 1:
        raise InputFileError(bag, f"tells efforts on {', '.join(with_effort)}", "one of them as --topic")
    return next(iter(with_effort.values())).recordings(joints)


@dataclass(frozen=True)
class _Messages:
    """The messages of a topic, each with the time at which it was recorded [ns]."""

    bag: Path
    topic: str
    kind: str
    stamped: list[tuple[int, Any]]

    def has_effort(self, joints: Sequence[str]) -> bool:
        """Whether there are efforts for these joints, or for any."""
        return any(_has_effort(self.kind, m) and set(joints) <= _names(self.kind, m) for _, m in self.stamped)

    def recordings(self, joints: Sequence[str]) -> list[JointRecording]:
        """Return what the messages with these joints tell."""
        groups = defaultdict(list)
        for recorded_ns, message in self.stamped:
            names = _names(self.kind, message)
            if set(joints) <= names and _has_effort(self.kind, message):
                groups[tuple(sorted(names))].append((recorded_ns, message))
        chosen = max(groups.values(), key=len)
        source = f"{self.bag}: {self.topic}"
        if self.kind == JOINT_TRAJECTORY:
            return [_of_trajectory(source, message) for _, message in chosen]
        return [_of_states(source, chosen)]


def _of_states(source: str, stamped: Sequence[tuple[int, Any]]) -> JointRecording:
    names = tuple(stamped[0][1].name)
    moments_ns = np.array([time_ns(message.header.stamp) for _, message in stamped], dtype=np.int64)
    if not np.any(moments_ns):  # nobody has set the stamps
        moments_ns = np.array([recorded_ns for recorded_ns, _ in stamped], dtype=np.int64)
    order = {names: np.arange(len(names))}

    def rows(field: str) -> FloatArray:
        values = np.empty((len(stamped), len(names)))
        for k, (_, message) in enumerate(stamped):
            row, its_names = getattr(message, field), tuple(message.name)
            if its_names not in order:
                order[its_names] = np.array([its_names.index(name) for name in names])
            if len(row) != len(names):
                found = f"message {k + 1} has {counted(len(row), 'value')} in {field}"
                raise InputFileError(source, found, f"one for each of its {len(names)} joints")
            values[k] = np.asarray(row)[order[its_names]]
        return values

    time_s = (moments_ns - moments_ns[0]) / NS_PER_S
    return JointRecording(source, names, time_s, rows("position"), rows("effort"))


def _of_trajectory(source: str, message: Any) -> JointRecording:
    names = tuple(message.joint_names)
    moments_ns = np.array([time_ns(point.time_from_start) for point in message.points], dtype=np.int64)

    def rows(field: str) -> FloatArray:
        values = [getattr(point, field) for point in message.points]
        for k, row in enumerate(values):
            if len(row) != len(names):
                found = f"point {k + 1} has {len(row)} {field}"
                raise InputFileError(source, found, f"one for each of its {len(names)} joints")
        return np.array(values, dtype=np.float64).reshape(-1, len(names))

    time_s = (moments_ns - moments_ns[0]) / NS_PER_S
    return JointRecording(source, names, time_s, rows("positions"), rows("effort"))


def _names(kind: str, message: Any) -> set[str]:
    return set(message.name if kind == JOINT_STATE else message.joint_names)


def _has_effort(kind: str, message: Any) -> bool:
    if kind == JOINT_STATE:
        return len(message.effort) > 0
    return any(len(point.effort) > 0 for point in message.points)


def _files(bag: Path) -> list[Path]:
    if not bag.exists():
        raise InputFileError(bag, "there is no such file or folder", _EXPECTED)
    if bag.is_file() or (bag / METADATA_FILE).is_file():
        return [bag]
    # A recording that was cut off, or somebody has copied the data alone.
    files = sorted(file for file in bag.iterdir() if file.suffix in DATA_FILES)
    if not files:
        raise InputFileError(bag, "has neither metadata.yaml nor data files", _EXPECTED)
    return files


def _list(named: dict[str, str]) -> str:
    return ", ".join(f"{topic} ({kind})" for topic, kind in sorted(named.items()))
