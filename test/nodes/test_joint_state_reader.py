"""What is read of joint states that come in another order than they were sent."""

from __future__ import annotations

import numpy as np
import pytest
from sensor_msgs.msg import JointState

from tel_ros.core.config import ArmConfig, ControlConfig
from tel_ros.core.errors import StateError
from tel_ros.nodes.conversions import to_time
from tel_ros.nodes.joint_state_reader import JointStateReader

ARM = ArmConfig(
    name="forearm",
    urdf="forearm.urdf",
    joints=("elbow",),
    hand_link="hand",
    stiffness_nm_per_rad=(15.0,),
    damping_nms_per_rad=(1.5,),
    effort_limit_nm=(20.0,),
    velocity_limit_rad_s=(2.0,),
)


def joint_state(stamp_ms: int, position_rad: float) -> JointState:
    message = JointState(name=["elbow"], position=[position_rad])
    message.header.stamp = to_time(stamp_ms * 1_000_000)
    return message


def test_an_overtaken_state_is_refused_and_leaves_the_velocity_estimate_alone() -> None:
    straight, shuffled = (JointStateReader(ARM, ControlConfig()) for _ in range(2))
    for ms in (0, 4, 8, 12):
        expected = straight.read(joint_state(ms, 1e-3 * ms))
        found = shuffled.read(joint_state(ms, 1e-3 * ms))
        if ms > 4:
            with pytest.raises(StateError, match=r"0\.004 s older than one that came before it"):
                shuffled.read(joint_state(ms - 4, 7.0))
    np.testing.assert_array_equal(found.velocity_rad_s, expected.velocity_rad_s)
    assert abs(expected.velocity_rad_s[0]) > 0.5


def test_a_message_that_cannot_be_used_does_not_count_as_the_newest() -> None:
    reader = JointStateReader(ARM, ControlConfig())
    reader.read(joint_state(0, 0.0))
    broken = joint_state(50, 0.0)
    broken.position = []
    with pytest.raises(StateError, match="1 names, 0 positions"):
        reader.read(broken)
    assert reader.read(joint_state(4, 0.0)).time_ns == 4_000_000


def test_a_broken_position_does_not_disturb_the_velocity_that_is_made_of_positions() -> None:
    reader = JointStateReader(ARM, ControlConfig())
    for ms in (0, 4, 8):
        before = reader.read(joint_state(ms, 1e-3 * ms)).velocity_rad_s
    with pytest.raises(StateError, match="elbow has jumped by 1e\\+09 rad"):
        reader.read(joint_state(12, 1e9))
    after = reader.read(joint_state(16, 1e-3 * 16)).velocity_rad_s
    np.testing.assert_allclose(after, before)
