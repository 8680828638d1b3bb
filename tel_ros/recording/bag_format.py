"""What bags are made of: types of messages and quality of service."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from functools import cache, partial
from io import StringIO
from typing import Any

import numpy as np
import yaml
from rosbags import interfaces as ros
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore
from ruamel.yaml import YAML

from tel_ros.recording import topics
from tel_ros.recording.shared_files import share_folder

_OURS = ("ControlState", "TrialGoal", "TrialResult")
_DEPTH = 10
_IN_BASE64 = "text in Base64:"
_INFINITE = ros.QosTime(9223372036, 854775807)
"""The longest time that rosbag2 can tell: no deadline, no lifespan, no lease."""


@cache
def typestore() -> Typestore:
    """Return the types of ROS 2 Jazzy and ``tel_interfaces``: for writing, and bags without them."""
    store = get_typestore(Stores.ROS2_JAZZY)
    folder = share_folder("tel_interfaces") / "msg"
    for name in _OURS:
        text = (folder / f"{name}.msg").read_text(encoding="utf-8")
        store.register(get_types_from_msg(text, f"tel_interfaces/msg/{name}"))
    return store


def definition(kind: str) -> tuple[str, str]:
    """Return the definition of one of our types as bags hold it, and its hash (RIHS01)."""
    return typestore().generate_msgdef(kind, ros_version=2)[0], typestore().hash_rihs01(kind)


def to_cdr(name: str, message: Any) -> bytes:
    """Return a message, of a type such as ``tel_interfaces/msg/TrialGoal``, in the form that bags hold.

    ROS's own serialisation adds stray bytes after an empty array of doubles, and readers of bags then refuse
    the message.
    """
    return bytes(typestore().serialize_cdr(_record(name, message), name))


def _record(name: str, message: Any) -> Any:
    store = typestore()
    _, fields = store.fielddefs[name]
    get = message.__getitem__ if isinstance(message, Mapping) else partial(getattr, message)
    return store.types[name](**{key: _value(kind, get(key)) for key, kind in fields})


def _value(kind: Any, value: Any) -> Any:
    nodetype, of = kind
    if nodetype == ros.Nodetype.NAME:
        return _record(of, value)
    if nodetype == ros.Nodetype.BASE:
        return value
    (element_type, element), _ = of
    if element_type == ros.Nodetype.NAME:
        return [_record(element, each) for each in value]
    return list(value) if element[0] == "string" else np.array(value, dtype=element[0])


def as_yaml_keeps_it(key: str, text: str) -> str:
    """Return a text, in Base64 where rosbags' YAML would change it: it folds some long lines wrongly."""
    emitter, stream = YAML(typ="safe"), StringIO()
    emitter.default_flow_style = False
    # metadata.yaml has it one level deeper than the data file: lines are folded elsewhere.
    emitter.dump({"custom_data": {key: text}, "deeper": {"custom_data": {key: text}}}, stream)
    try:
        read = yaml.load(stream.getvalue(), Loader=yaml.CSafeLoader)
        kept = read["custom_data"][key] == read["deeper"]["custom_data"][key] == text
    except yaml.YAMLError:
        kept = False
    return text if kept else _IN_BASE64 + base64.b64encode(text.encode()).decode("ascii")


def plain_text(stored: str) -> str:
    """Return a text of the metadata as it was before :func:`as_yaml_keeps_it`."""
    in_base64 = stored.startswith(_IN_BASE64)
    return base64.b64decode(stored.removeprefix(_IN_BASE64)).decode() if in_base64 else stored


def offered_qos(topic: str, *, latched: bool = False) -> ros.Qos:
    """Return how to play a topic of a trial: reliable, and latched if a trial has it once."""
    once = latched or any(topics.is_named(topic, name) for name in topics.RECORDED_ONCE)
    return ros.Qos(
        history=ros.QosHistory.KEEP_LAST,
        depth=1 if once else _DEPTH,
        reliability=ros.QosReliability.RELIABLE,
        durability=ros.QosDurability.TRANSIENT_LOCAL if once else ros.QosDurability.VOLATILE,
        deadline=_INFINITE,
        lifespan=_INFINITE,
        liveliness=ros.QosLiveliness.AUTOMATIC,
        liveliness_lease_duration=_INFINITE,
        avoid_ros_namespace_conventions=False,
    )
