"""Joint recordings from CSVs and bags: rosbag1, rosbag2 in sqlite3 or MCAP, with or without metadata.yaml.

Two messages are understood: ``sensor_msgs/JointState`` with efforts, and ``trajectory_msgs/JointTrajectory``
whose points have efforts; each of the latter is a recording by itself.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from tel_ros.core.errors import InputFileError
from tel_ros.core.learning.joint_recording import JointRecording
from tel_ros.core.types import NS_PER_S, FloatArray
from tel_ros.recording.any_bag import open_any_bag, reading
from tel_ros.recording.cdr import time_ns
from tel_ros.recording.data_files import DATA_FILES, data_kind
from tel_ros.recording.foreign.csv_files import read_csv_recording
from tel_ros.recording.foreign.plausible import JointRange, require_plausible
from tel_ros.recording.foreign.renaming import Renaming, advice
from tel_ros.recording.joint_states import Stamped, merged_states
from tel_ros.recording.topics import JOINT_STATE, JOINT_TRAJECTORY

BAG_FILES = (".bag", *DATA_FILES)
_EXPECTED = "a bag with sensor_msgs/JointState or trajectory_msgs/JointTrajectory with efforts"


@dataclass(frozen=True, kw_only=True)
class Wanted:
    """What to read of recordings.

    ``topic``: of bags; empty: chosen by what they tell. ``joints``: to learn, in this order; empty: all whose
    efforts the first source tells, of those that the URDF has. ``urdf``: ranges of its movable joints, if
    any.
    """

    topic: str = ""
    joints: tuple[str, ...] = ()
    urdf: Mapping[str, JointRange] = field(default_factory=dict)
    renaming: Renaming = str

    def among(self, told: Sequence[str]) -> list[str]:
        """Return the joints of those with efforts that are to be learned, as far as it is known."""
        of_arm = self.joints or self.urdf
        return [joint for joint in told if joint in of_arm] if of_arm else list(told)


def read_source(source: Path, wanted: Wanted | None = None) -> list[JointRecording]:
    """Read a bag or a CSV: see :func:`read_bag` and :func:`.csv_files.read_csv_recording`."""
    wanted = wanted or Wanted()
    if source.suffix.lower() == ".csv":
        return [read_csv_recording(source, wanted.joints, wanted.renaming)]
    if source.is_file() and data_kind(source) not in BAG_FILES:
        expected = f"a folder of rosbag2, or a file {', '.join((*BAG_FILES, '.csv'))}"
        found = f"is a {source.suffix} file" if source.suffix else "is a file without an ending"
        raise InputFileError(source, found, expected)
    return read_bag(source, wanted)


def read_sources(
    sources: Sequence[Path], wanted: Wanted | None = None
) -> tuple[list[JointRecording], dict[str, tuple[float, float]], list[str]]:
    """Read recordings of one arm; InputFileError if one cannot be used, or cannot be of that arm.

    Returns:
        Recordings of the joints to learn, each fit to be learned from; within which positions other joints
        stayed, by name; and what is to be doubted, in words.
    """
    wanted = wanted or Wanted()
    found = [recording for source in sources for recording in read_source(source, wanted)]
    told = found[0].with_effort()
    joints = wanted.joints or tuple(wanted.among(told)) or told or found[0].joints
    if wanted.urdf and not set(joints) <= wanted.urdf.keys():
        other = [joint for joint in joints if joint not in wanted.urdf]
        expected = f"movable joints of the URDF: {', '.join(wanted.urdf)}{advice(other, wanted.urdf)}"
        raise InputFileError(found[0].source, f"has the joints {', '.join(other)}", expected)
    for recording in found:
        extra = [joint for joint in wanted.among(recording.with_effort()) if joint not in found[0].joints]
        if extra:
            expected = f"the joints of {found[0].source}: {', '.join(found[0].joints)}{advice(extra, joints)}"
            raise InputFileError(recording.source, f"has the joints {', '.join(extra)}", expected)
    chosen = [recording.of(joints) for recording in found]
    doubts = []
    for recording in chosen:
        recording.require_learnable()
        doubts += require_plausible(recording, wanted.urdf)
    others: dict[str, tuple[float, float]] = {}
    for joint, (low, high) in (each for recording in found for each in recording.ranges_rad().items()):
        if joint not in joints:
            least, most = others.get(joint, (low, high))
            others[joint] = (min(least, low), max(most, high))
    return chosen, others, doubts


def read_bag(bag: Path, wanted: Wanted | None = None) -> list[JointRecording]:
    """Read what a bag tells of joints and their efforts; InputFileError if that is none, or ambiguous.

    Of several topics that one is read which tells most of the wanted joints; another one only if it has those
    that this one lacks. Joint states become one recording of all joints on one time base, each trajectory is
    one.
    """
    wanted, refusal = wanted or Wanted(), partial(InputFileError, bag)
    with reading(bag, _EXPECTED), open_any_bag(bag, closed=False) as reader:
        kinds = {c.topic: c.msgtype for c in reader.connections}
        listed = ", ".join(f"{topic} ({kind})" for topic, kind in sorted(kinds.items()))
        of_joints = sorted(t for t, kind in kinds.items() if kind in (JOINT_STATE, JOINT_TRAJECTORY))
        if (topic := wanted.topic) and topic not in of_joints:
            found = f"{topic} has messages {kinds[topic]}" if topic in kinds else f"has no topic {topic}"
            raise refusal(found, f"a topic of joints (it has {listed})")
        if not of_joints:
            raise refusal(f"has the topics {listed or 'of no messages'}", _EXPECTED)
        read: dict[str, list[tuple[int, Any]]] = {}
        for topic in [wanted.topic] if wanted.topic else of_joints:
            connections = [c for c in reader.connections if c.topic == topic]
            for fmt in {getattr(c.ext, "serialization_format", "cdr") for c in connections} - {"cdr", "ros1"}:
                raise refusal(f"has {topic} serialised as {fmt!r}", "messages serialised as 'cdr'")
            read[topic] = reader.contents(connections)
    if not any(read.values()):
        raise refusal(f"has no messages on {', '.join(read)}: it is empty", _EXPECTED)
    told = {t: _with_effort(kinds[t], messages, wanted.renaming) for t, messages in read.items()}
    every = list(dict.fromkeys(joint for names in told.values() for joint in names))
    missing = [joint for joint in wanted.joints if joint not in every]
    if missing or not every:
        found = f"tells no effort on {', '.join(read)}" + (f" for {', '.join(missing)}" if missing else "")
        raise refusal(found, f"efforts in N·m: what the torque is learned from{advice(every, missing)}")
    fitting = {t: set(wanted.among(names)) for t, names in told.items() if wanted.among(names)}
    if not fitting:
        expected = f"joints of the URDF: {', '.join(wanted.urdf)}{advice(every, wanted.urdf)}"
        raise refusal(f"tells efforts of {', '.join(every)}", expected)
    fullest_first = sorted(fitting, key=lambda each: -len(fitting[each]))
    best, of_arm = fullest_first[0], bool(wanted.joints or wanted.urdf)
    chosen, covered = {best: fitting[best]}, set(fitting[best])
    for topic in fullest_first[1:]:
        if not of_arm or fitting[topic] >= covered:
            raise refusal(f"tells efforts on {', '.join(fitting)}", "one of them as --topic")
        if kinds[topic] == JOINT_STATE and (new := fitting[topic] - covered):
            chosen[topic] = new
            covered |= new
    source = f"{bag}: {', '.join(chosen)}"
    if kinds[best] == JOINT_TRAJECTORY:
        return [
            _of_trajectory(source, message, wanted.renaming)
            for _, message in read[best]
            if fitting[best] <= set(map(wanted.renaming, message.joint_names)) and _tells_effort(message)
        ]

    def stamped(topic: str, recorded_ns: int, message: Any) -> Stamped:
        names = map(wanted.renaming, message.name)
        counts = tuple(n if topic == best or n in chosen[topic] else "" for n in names)
        return Stamped(recorded_ns, message, counts)

    states = [stamped(topic, *recorded) for topic in chosen for recorded in read[topic]]
    return [merged_states(source, states, wanted.joints or sorted(covered))]


def _with_effort(kind: str, messages: Sequence[tuple[int, Any]], renaming: Renaming) -> list[str]:
    if kind == JOINT_STATE:
        names = {tuple(message.name) for _, message in messages if len(message.effort)}
    else:
        names = {tuple(message.joint_names) for _, message in messages if _tells_effort(message)}
    return list(dict.fromkeys(renaming(name) for each in sorted(names) for name in each))


def _tells_effort(message: Any) -> bool:
    return any(len(point.effort) > 0 for point in message.points)


def _of_trajectory(source: str, message: Any, renaming: Renaming) -> JointRecording:
    names = tuple(map(renaming, message.joint_names))
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
