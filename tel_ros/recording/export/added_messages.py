"""What a 3D view needs and bags do not hold: the arm's description, its links, the hand's paths."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from tel_ros.core.arm_description import ArmDescription
from tel_ros.core.config import ArmConfig
from tel_ros.core.errors import BagError, InputFileError
from tel_ros.core.kinematics import LinkJoint, SerialChain
from tel_ros.core.types import NS_PER_S, FloatArray, IntArray
from tel_ros.core.urdf import Urdf
from tel_ros.recording.bag_format import to_cdr
from tel_ros.recording.provenance import stored_config, stored_urdf
from tel_ros.recording.trial_bag import RecordedTrial

ROBOT_DESCRIPTION = "/robot_description"
"""std_msgs/String, once: the URDF as it was recorded."""
TF = "/tf"
"""tf2_msgs/TFMessage: the links behind joints that move."""
TF_STATIC = "/tf_static"
"""tf2_msgs/TFMessage, once: all other links."""

DESIRED_PATH = "/export/hand_path/desired"
"""nav_msgs/Path, once a trial, at its beginning: of the hand in RUN; empty if RUN was not reached."""
ACTUAL_PATH = "/export/hand_path/actual"
EQUILIBRIUM_PATH = "/export/hand_path/equilibrium"
ERROR = "/export/error_rad"
"""std_msgs/Float64MultiArray, every tick of RUN: measured minus desired position of each joint."""
EFFORT_LIMIT = "/export/effort_limit_nm"
"""std_msgs/Float64MultiArray at both ends of a trial: the limit of each joint, then its negative for each."""

STREAMED = {
    TF: "tf2_msgs/msg/TFMessage",
    ERROR: "std_msgs/msg/Float64MultiArray",
    EFFORT_LIMIT: "std_msgs/msg/Float64MultiArray",
}
ADDED = {
    ROBOT_DESCRIPTION: "std_msgs/msg/String",
    TF_STATIC: "tf2_msgs/msg/TFMessage",
    **dict.fromkeys((DESIRED_PATH, ACTUAL_PATH, EQUILIBRIUM_PATH), "nav_msgs/msg/Path"),
    **STREAMED,
}
"""Topic to type of everything that is added."""
THINNED_NS = NS_PER_S // 50
"""Least time between two poses: an eye sees no more, and poses are long messages."""

Added = tuple[str, int, bytes]
"""Topic, time in the exported file [ns], serialised message."""


@dataclass(frozen=True)
class ExportedArm:
    """The arm of a run: ``root`` is the link that everything is placed in, ``meshes`` the URDF's files."""

    config: ArmConfig
    urdf: str
    root: str
    joints: tuple[LinkJoint, ...]
    chain: SerialChain
    meshes: tuple[str, ...]

    @property
    def reach_m(self) -> float:
        """Sum of the lengths of the links to the hand, which is never further from the root."""
        return float(sum(np.linalg.norm(joint.origin_m) for joint in self.chain.joints))


def exported_arm(bag: Path, metadata: Mapping[str, str]) -> ExportedArm:
    """Return the arm of a bag; BagError if parts of it are missing, ConfigError if they contradict."""
    config = stored_config(bag, metadata).arm
    try:
        urdf = Urdf(stored_urdf(bag, metadata), config.urdf)
        arm = ArmDescription.of(urdf, config)
    except InputFileError as error:
        raise BagError(bag, f"holds a URDF that is {error.found}", "that of the arm") from error
    meshes = dict.fromkeys(m.get("filename", "") for link in urdf.links.values() for m in link.iter("mesh"))
    return ExportedArm(
        config=config,
        urdf=urdf.text,
        root=urdf.root,
        joints=arm.link_joints,
        chain=arm.chain(config.hand_link),
        meshes=tuple(meshes),
    )


def messages_of_arm(arm: ExportedArm, time_ns: int) -> Iterator[Added]:
    """Yield the messages that a file has once, at its beginning."""
    yield ROBOT_DESCRIPTION, time_ns, to_cdr(ADDED[ROBOT_DESCRIPTION], {"data": arm.urdf})
    still = [each for each in arm.joints if each.joint.index is None]
    yield TF_STATIC, time_ns, next(_transforms(TF_STATIC, still, [time_ns], np.zeros((1, 0))))


def messages_of_trial(
    trial: RecordedTrial, arm: ExportedArm, begin_ns: int, end_ns: int, shift_ns: int
) -> list[Added]:
    """Return what is added to a trial, in order; ``shift_ns``: between recorded times and the file's."""
    times_ns = trial.time_ns + shift_ns
    limits = np.array(arm.config.effort_limit_nm)
    bounds = to_cdr(ADDED[EFFORT_LIMIT], _array(np.concatenate([limits, -limits])))
    messages: list[Added] = [(EFFORT_LIMIT, time_ns, bounds) for time_ns in (begin_ns, end_ns)]

    run = np.flatnonzero(trial.run)
    desired_rad = trial.desired[:, : len(trial.joints)]
    seen = run[thinned(times_ns[run])]
    for topic, positions_rad in (
        (DESIRED_PATH, desired_rad),
        (ACTUAL_PATH, trial.position_rad),
        (EQUILIBRIUM_PATH, trial.equilibrium_rad),
    ):
        hand_m = arm.chain.hand_positions(positions_rad[seen])
        straight = _vector((0.0, 0.0, 0.0, 1.0))
        poses = [
            {
                "header": _header(time_ns, arm.root),
                "pose": {"position": _vector(position_m), "orientation": straight},
            }
            for time_ns, position_m in zip(times_ns[seen].tolist(), hand_m, strict=True)
        ]
        path = to_cdr(ADDED[topic], {"header": _header(begin_ns, arm.root), "poses": poses})
        messages.append((topic, begin_ns, path))

    moving = [each for each in arm.joints if each.joint.index is not None]
    rows = thinned(times_ns)
    thinned_ns = times_ns[rows].tolist()
    transforms = _transforms(TF, moving, thinned_ns, trial.position_rad[rows])
    messages += [(TF, time_ns, raw) for time_ns, raw in zip(thinned_ns, transforms, strict=True)]

    error_rad = trial.position_rad - desired_rad
    messages += [(ERROR, int(times_ns[k]), to_cdr(ADDED[ERROR], _array(error_rad[k]))) for k in run]
    return sorted(messages, key=lambda message: message[1])


def thinned(times_ns: IntArray) -> IntArray:
    """Return the indices of the times to keep: the first of each :data:`THINNED_NS`, and the last."""
    if not len(times_ns):
        return np.zeros(0, dtype=np.int64)
    _, first = np.unique((times_ns - times_ns[0]) // THINNED_NS, return_index=True)
    kept: IntArray = np.union1d(first, [len(times_ns) - 1]).astype(np.int64)
    return kept


def _transforms(
    topic: str, joints: list[LinkJoint], times_ns: list[int], position_rad: FloatArray
) -> Iterator[bytes]:
    """Yield the placements of some links, one message a row of ``position_rad``."""
    placed = [each.joint.placements(position_rad) for each in joints]
    quaternions = [Rotation.from_matrix(turned).as_quat() for _, turned in placed]
    for row, time_ns in enumerate(times_ns):
        transforms = [
            {
                "header": _header(time_ns, each.parent),
                "child_frame_id": each.child,
                "transform": {"translation": _vector(places[row]), "rotation": _vector(turned[row])},
            }
            for each, (places, _), turned in zip(joints, placed, quaternions, strict=True)
        ]
        yield to_cdr(ADDED[topic], {"transforms": transforms})


def _header(time_ns: int, frame: str) -> dict[str, Any]:
    return {"stamp": dict(zip(("sec", "nanosec"), divmod(time_ns, NS_PER_S), strict=True)), "frame_id": frame}


def _vector(values: Iterable[float]) -> dict[str, float]:
    return dict(zip("xyzw", map(float, values), strict=False))


def _array(values: FloatArray) -> dict[str, Any]:
    return {"layout": {"dim": [], "data_offset": 0}, "data": values}
