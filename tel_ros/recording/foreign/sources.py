"""Any recording of joints, by the kind of its file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from tel_ros.core.errors import InputFileError
from tel_ros.core.learning.joint_recording import JointRecording
from tel_ros.recording.foreign.bag_source import BAG_FILES, read_bag
from tel_ros.recording.foreign.csv_source import read_csv_recording


def read_source(source: Path, topic: str = "", joints: Sequence[str] = ()) -> list[JointRecording]:
    """Read a bag or a CSV. See :func:`.bag_source.read_bag` and :func:`.csv_source.read_csv_recording`.

    Raises:
        InputFileError: it is missing, of another kind, cannot be read, or tells no positions or efforts.
    """
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
        InputFileError: see :func:`read_source`; a recording lacks a joint, cannot be learned from, or tells
            other joints than the first one does.
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
