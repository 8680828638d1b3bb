"""Small bags of made-up arms, as other recorders write them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from synthetic_trial import message, stamp

from tel_ros.recording.bag_format import typestore

STATES = "sensor_msgs/msg/JointState"
TEXT = "std_msgs/msg/String"
MCAP, SQLITE3 = StoragePlugin.MCAP, StoragePlugin.SQLITE3
_LONG = QosTime(2147483647, 4294967295)
LATCHED = Qos(
    QosHistory.KEEP_LAST,
    1,
    QosReliability.RELIABLE,
    QosDurability.TRANSIENT_LOCAL,
    _LONG,
    _LONG,
    QosLiveliness.AUTOMATIC,
    _LONG,
    False,
)


def joint_state(
    stamp_ns: int, names: Sequence[str], position_rad: Sequence[float], effort_nm: Sequence[float] = ()
) -> bytes:
    """Return a joint state without velocities."""
    header = typestore().types["std_msgs/msg/Header"](stamp=stamp(stamp_ns), frame_id="")
    fields = {"position": position_rad, "velocity": (), "effort": effort_nm}
    arrays: dict[str, Any] = {name: np.array(values, dtype=float) for name, values in fields.items()}
    return message(STATES, header=header, name=list(names), **arrays)


def text(words: str) -> bytes:
    return message(TEXT, data=words)


def write_bag(
    bag: Path,
    rows: Sequence[tuple[str, str, int, bytes]],
    storage: StoragePlugin = MCAP,
    latched: Sequence[str] = (),
    custom: dict[str, str] | None = None,
) -> Path:
    """Write a rosbag2 of rows of topic, type, time in ns and bytes."""
    with Writer(bag, version=9, storage_plugin=storage) as writer:
        for key, value in (custom or {}).items():
            writer.set_custom_data(key, value)
        connections = {}
        for topic, kind, time_ns, raw in rows:
            if topic not in connections:
                connections[topic] = writer.add_connection(
                    topic,
                    kind,
                    typestore=_store(kind),
                    offered_qos_profiles=[LATCHED] if topic in latched else [],
                )
            writer.write(connections[topic], time_ns, raw)
    return bag


def _store(kind: str) -> Any:
    """Return the types of ROS and ours; one that nobody knows is made up."""
    if kind in typestore().types:
        return typestore()
    store = get_typestore(Stores.ROS2_JAZZY)
    store.register(get_types_from_msg("float64 value\n", kind))
    return store
