"""Fields read where they lie are those of the whole message, in both byte orders."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from rosbags.typesys.store import Typestore

from tel_ros.recording.bag_format import typestore
from tel_ros.recording.serialised import answered_ns, header_stamp_ns, trial_index

ORDERS = pytest.mark.parametrize("little", [True, False], ids=["little", "big"])


def cdr(kind: str, message: Any, little: bool) -> bytes:
    return bytes(typestore().serialize_cdr(message, kind, little_endian=little))


def header(store: Typestore, frame_id: str) -> Any:
    stamp = store.types["builtin_interfaces/msg/Time"](sec=1_795_468_340, nanosec=999_999_999)
    return store.types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame_id)


@ORDERS
@pytest.mark.parametrize("frame_id", ["", "a", "base", "a link of the arm"])
def test_stamp_and_trial_of_a_control_state(little: bool, frame_id: str) -> None:
    store, kind = typestore(), "tel_interfaces/msg/ControlState"
    arrays = {
        name: np.zeros(0, dtype=bool if name == "saturated" else np.float64)
        for name, _ in store.fielddefs[kind][1]
        if name not in ("header", "trial", "phase", "time_from_start_s")
    }
    message = store.types[kind](
        header=header(store, frame_id), trial=70_000, phase=3, time_from_start_s=0.5, **arrays
    )
    raw = cdr(kind, message, little)
    assert header_stamp_ns(raw) == 1_795_468_340_999_999_999
    assert trial_index(raw) == 70_000


@ORDERS
@pytest.mark.parametrize(
    ("labels", "expected"),
    [
        (["1795468340999999999"], 1_795_468_340_999_999_999),
        (["0"], 0),
        ([], None),
        ([""], None),
        (["arm_guard"], None),
        (["-5"], None),
        (["joints", "ab", "12345"], 12_345),
    ],
)
def test_what_a_command_answers(labels: list[str], expected: int | None, little: bool) -> None:
    types = typestore().types
    dimensions = [
        types["std_msgs/msg/MultiArrayDimension"](label=label, size=7, stride=123_456) for label in labels
    ]
    layout = types["std_msgs/msg/MultiArrayLayout"](dim=dimensions, data_offset=0)
    kind = "std_msgs/msg/Float64MultiArray"
    assert answered_ns(cdr(kind, types[kind](layout=layout, data=np.ones(7)), little)) == expected
