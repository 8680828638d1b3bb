"""The message types of the bags, our own included."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from tel_ros.recording.shared_files import share_folder

_OURS = ("ControlState", "TrialGoal", "TrialResult")


@cache
def typestore() -> Typestore:
    """Return the types of ROS 2 Jazzy together with those of ``tel_interfaces``, as installed.

    Only writing needs it: a bag carries the definitions of what it holds.
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
