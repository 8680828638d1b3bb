"""Packed messages are what ROS reads, and what ROS writes is read the same way, whole or field by field."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
import pytest
from rosbags.typesys.store import Typestore

from tel_ros.core.arm_state import ArmState
from tel_ros.core.trial import Phase, Tick
from tel_ros.recording.bag_format import typestore
from tel_ros.recording.cdr import (
    CommandLayout,
    ControlStateLayout,
    JointStateLayout,
    answered_ns,
    header_stamp_ns,
    packed_command,
    trial_index,
)

STAMP_NS = 1_795_468_340_999_999_999
NAMES = pytest.mark.parametrize(
    "names", [["q"], ["shoulder", "elbow"], ["lbr_iiwa_joint_1", "Ä", "", "a.b", "abcd", "abc", "ab"]]
)


def cdr(kind: str, message: Any, little: bool = True) -> bytes:
    return bytes(typestore().serialize_cdr(message, kind, little_endian=little))


def read(kind: str, raw: bytes) -> Any:
    return typestore().deserialize_cdr(raw, kind)


def layout_of(kind: Any, raw: bytes) -> Any:
    """Return the layout of a message, or None if it has none."""
    try:
        return kind(raw=raw)
    except (struct.error, ValueError):
        return None


def numbers(n: int, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=n)


def joint_state(
    names: list[str], lengths: tuple[int, int, int], frame_id: str = "", little: bool = True
) -> bytes:
    types, kind = typestore().types, "sensor_msgs/msg/JointState"
    stamp = types["builtin_interfaces/msg/Time"](*divmod(STAMP_NS, 10**9))
    header = types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame_id)
    q, v, e = (numbers(n, k) for k, n in enumerate(lengths))
    return cdr(kind, types[kind](header=header, name=names, position=q, velocity=v, effort=e), little)


def command(labels: list[str], n: int, little: bool = True) -> bytes:
    types, kind = typestore().types, "std_msgs/msg/Float64MultiArray"
    dimensions = [types["std_msgs/msg/MultiArrayDimension"](label=x, size=n, stride=n) for x in labels]
    layout = types["std_msgs/msg/MultiArrayLayout"](dim=dimensions, data_offset=0)
    return cdr(kind, types[kind](layout=layout, data=numbers(n, 9)), little)


@NAMES
@pytest.mark.parametrize("frame_id", ["", "base", "world!"])
@pytest.mark.parametrize("told", [(1, 1, 1), (1, 0, 0), (1, 1, 0)], ids=["all", "positions", "no effort"])
def test_joint_states_are_read_as_they_were_written(
    names: list[str], frame_id: str, told: tuple[int, int, int]
) -> None:
    lengths = tuple(len(names) * t for t in told)
    raw = joint_state(names, lengths, frame_id)
    layout = layout_of(JointStateLayout, raw)
    assert layout is not None
    assert layout.names == tuple(names)
    found = layout.read(raw)
    assert found is not None
    assert found.stamp_ns == STAMP_NS
    for k, values in enumerate((found.position_rad, found.velocity_rad_s, found.effort_nm)):
        assert values == tuple(numbers(lengths[k], k))


@NAMES
def test_packed_joint_states_are_read_by_others(names: list[str]) -> None:
    n = len(names)
    q, v, e = (numbers(n, k).tolist() for k in range(3))
    raw = JointStateLayout(names, (n, n, n)).packed(STAMP_NS, q, v, e)
    message = read("sensor_msgs/msg/JointState", raw)
    assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == STAMP_NS
    assert (message.name, message.header.frame_id) == (names, "")
    assert [message.position.tolist(), message.velocity.tolist(), message.effort.tolist()] == [q, v, e]


def test_another_layout_of_the_same_size_is_not_taken_for_this_one() -> None:
    here = joint_state(["shoulder", "elbow"], (2, 2, 2))
    layout = layout_of(JointStateLayout, here)
    assert layout is not None
    for names in (["elbow", "shoulder"], ["shouldex", "elbow"], ["shoulders", "elbo"]):
        other = joint_state(names, (2, 2, 2))
        assert len(other) == len(here)
        assert layout.read(other) is None
    assert layout.read(joint_state(["shoulder", "elbow"], (2, 1, 3))) is None
    assert layout.read(here) is not None


def test_padding_may_hold_anything() -> None:
    """Fast CDR leaves what was there before."""
    raw = bytearray(joint_state(["shoulder", "elbow"], (2, 2, 2)))
    layout = layout_of(JointStateLayout, bytes(raw))
    assert layout is not None
    first_name_ends = 4 + 8 + 4 + 1 + 3 + 4 + 4 + len("shoulder\0")
    for place in (17, 18, 19, first_name_ends, first_name_ends + 1, first_name_ends + 2):
        assert raw[place] == 0
        raw[place] = 0xCD
    assert layout.read(bytes(raw)) == layout.read(joint_state(["shoulder", "elbow"], (2, 2, 2)))


def test_options_of_the_encoding_do_not_count() -> None:
    """Some middlewares tell there by how much they have padded."""
    plain, dressed = joint_state(["q"], (1, 1, 1)), bytearray(joint_state(["q"], (1, 1, 1)))
    dressed[3] = 3
    layout = layout_of(JointStateLayout, bytes(dressed))
    assert layout is not None
    assert layout.read(bytes(dressed)) == layout.read(plain) is not None


def test_what_cannot_be_told_has_no_layout() -> None:
    whole = joint_state(["shoulder", "elbow"], (2, 2, 2))
    assert layout_of(JointStateLayout, joint_state(["shoulder"], (1, 1, 1), little=False)) is None
    for end in range(len(whole)):
        assert layout_of(JointStateLayout, whole[:end]) is None
    huge = whole[:20] + struct.pack("<I", 0xFFFFFFFF) + whole[24:]
    assert layout_of(JointStateLayout, huge) is None
    for end in range(len(command(["12"], 2))):
        assert layout_of(CommandLayout, command(["12"], 2)[:end]) is None
    assert layout_of(CommandLayout, command(["12"], 2, little=False)) is None
    assert layout_of(CommandLayout, command(["a", "12"], 2)) is None


@pytest.mark.parametrize("n", [0, 1, 2, 7])
@pytest.mark.parametrize("label", [None, "", "0", "arm_guard", "12345678", str(STAMP_NS)])
def test_commands_are_read_as_they_were_written(label: str | None, n: int) -> None:
    raw = command([] if label is None else [label], n)
    layout = layout_of(CommandLayout, raw)
    assert layout is not None
    found = layout.read(raw)
    assert found is not None
    assert found.label == (label or "").encode()
    assert found.answered_ns == (int(label) if label and label.isdigit() else None)
    assert found.values == tuple(numbers(n, 9))


@pytest.mark.parametrize("label", ["", "0", "arm_guard", "12345678", str(STAMP_NS)])
def test_packed_commands_are_read_by_others(label: str) -> None:
    values = numbers(7, 1).tolist()
    message = read("std_msgs/msg/Float64MultiArray", packed_command(label, np.array(values)))
    (dimension,) = message.layout.dim
    assert (dimension.label, dimension.size, dimension.stride, message.layout.data_offset) == (label, 7, 7, 0)
    assert message.data.tolist() == values


def test_a_command_of_another_layout_is_not_taken_for_this_one() -> None:
    layout = layout_of(CommandLayout, command(["1234"], 2))
    assert layout is not None
    assert layout.read(command(["12345"], 2)) is None  # padded to the same size
    assert len(command(["12345"], 2)) == len(command(["1234"], 2))
    assert layout.read(command(["1234"], 3)) is None
    assert layout.read(command(["9876"], 2)) is not None


@pytest.mark.parametrize("n", [1, 2, 3, 7])
def test_packed_control_states_are_read_by_others(n: int) -> None:
    arrays = [numbers(n, k) for k in range(7)]
    saturated = np.arange(n) % 2 == 0
    tick = Tick(Phase.RUN, -0.25, *arrays[:4], arrays[6], saturated)
    raw = ControlStateLayout(n).packed(70_000, ArmState(STAMP_NS, arrays[4], arrays[5]), tick)
    kind = "tel_interfaces/msg/ControlState"
    message = read(kind, raw)
    fields = [name for name, _ in typestore().fielddefs[kind][1]]
    assert message.header.stamp.nanosec == STAMP_NS % 10**9
    assert (message.trial, message.phase, message.time_from_start_s) == (70_000, 3, -0.25)
    for name, expected in zip(fields[4:], [*arrays, saturated], strict=True):
        np.testing.assert_array_equal(getattr(message, name), expected)


def test_another_number_of_values_is_refused() -> None:
    with pytest.raises(struct.error):
        JointStateLayout(["a", "b"], (2, 2, 2)).packed(0, [0.0], [0.0, 0.0], [0.0, 0.0])
    with pytest.raises(struct.error):
        CommandLayout(2, "0").pack((b"0\0",), (2, 2), (0,), (0.0,))


ORDERS = pytest.mark.parametrize("little", [True, False], ids=["little", "big"])


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
