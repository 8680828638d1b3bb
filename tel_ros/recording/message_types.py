"""The message types of the bags, our own included."""

from __future__ import annotations

from functools import cache

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
