"""The loop's own reading of bytes is rclpy's, also where a message is dressed as no layout of ours."""

from __future__ import annotations

import numpy as np
import pytest
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, MultiArrayDimension

from tel_ros.core.config import ArmConfig, ControlConfig
from tel_ros.core.errors import StateError
from tel_ros.core.safety.gate import StateGate
from tel_ros.nodes.conversions import command_reader, joint_state_numbers, joint_state_reader, to_time
from tel_ros.recording.cdr import packed_command

ARM = ArmConfig(
    name="arm",
    urdf="arm.urdf",
    joints=("shoulder", "elbow"),
    hand_link="hand",
    stiffness_nm_per_rad=(15.0, 15.0),
    damping_nms_per_rad=(1.5, 1.5),
    effort_limit_nm=(20.0, 20.0),
    velocity_limit_rad_s=(20.0, 20.0),
)


def state(k: int, names: list[str], effort: bool = True) -> JointState:
    values = [0.1 * (j + 1) + 1e-4 * k for j in range(len(names))]
    message = JointState(name=names, position=values, velocity=[10.0 * q for q in values])
    message.effort = [100.0 * q for q in values] if effort else []
    message.header.stamp = to_time(k * 2_000_000)
    message.header.frame_id = "base" if k % 3 else ""
    return message


def test_bytes_and_messages_tell_the_same_state_whatever_the_order_of_the_joints() -> None:
    reader = joint_state_reader()
    of_bytes, of_messages = (StateGate(ARM, ControlConfig()) for _ in range(2))
    orders = (["shoulder", "elbow"], ["elbow", "shoulder"], ["gripper", "elbow", "shoulder"])
    for k in range(30):
        message = state(k, orders[k // 10], effort=k % 2 == 0)
        if k // 10:  # so that no joint jumps
            by_name = dict(zip(orders[0], (0.1, 0.2), strict=True))
            message.position = [by_name.get(name, 7.0) + 1e-4 * k for name in message.name]
        found = of_bytes.admit(*reader(serialize_message(message)), 0)
        expected = of_messages.admit(*joint_state_numbers(message), 0)
        assert found.time_ns == expected.time_ns
        np.testing.assert_array_equal(found.position_rad, expected.position_rad)
        np.testing.assert_array_equal(found.velocity_rad_s, expected.velocity_rad_s)
        assert (found.effort_nm is None) == (k % 2 == 1)
        if found.effort_nm is not None:
            np.testing.assert_array_equal(found.effort_nm, expected.effort_nm)


@pytest.mark.parametrize(
    ("raw", "match"),
    [
        (b"", "no joint state in 0 bytes"),
        (b"\0\1\0\0\0", "no joint state in 5 bytes"),
        (serialize_message(JointState()), "has no joints; expected also shoulder, elbow"),
        (serialize_message(JointState(name=["elbow"], position=[0.0])), "expected also shoulder"),
        (serialize_message(JointState(name=["shoulder", "elbow"], position=[0.0])), "2 names, 1 positions"),
    ],
    ids=["nothing", "too short", "no joints", "one joint", "one position"],  # bytes have stray padding
)
def test_what_is_no_state_of_the_arm_is_refused(raw: bytes, match: str) -> None:
    reader, gate = joint_state_reader(), StateGate(ARM, ControlConfig())
    with pytest.raises(StateError, match=match):
        gate.admit(*reader(raw), 0)
    gate.admit(*reader(serialize_message(state(1, ["shoulder", "elbow"]))), 0)


def test_commands_of_all_dresses_are_read() -> None:
    reader = command_reader()
    for labels, label in (
        ([], b""),
        (["17"], b"17"),
        (["joints", "23"], b"23"),
        (["arm_guard"], b"arm_guard"),
    ):
        message = Float64MultiArray(data=[1.0, -2.0])
        message.layout.dim = [MultiArrayDimension(label=text) for text in labels]
        found = reader(serialize_message(message))
        assert (found.label, found.values) == (label, (1.0, -2.0))
    with pytest.raises(StateError, match="no command in 3 bytes"):
        reader(b"abc")


def test_a_packed_command_is_what_rclpy_reads() -> None:
    message = deserialize_message(packed_command("42", np.array([1.5, -0.25])), Float64MultiArray)
    assert list(message.data) == [1.5, -0.25]
    assert [d.label for d in message.layout.dim] == ["42"]
