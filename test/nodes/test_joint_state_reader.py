"""What is read of joint states that come in another order than they were sent."""

from __future__ import annotations

import numpy as np
import pytest
from sensor_msgs.msg import JointState

from tel_ros.core.config import ControlConfig
from tel_ros.core.errors import StateError
from tel_ros.nodes.conversions import JointStateReader, to_time


def joint_state(stamp_ms: int, position_rad: float) -> JointState:
    message = JointState(name=["elbow"], position=[position_rad])
    message.header.stamp = to_time(stamp_ms * 1_000_000)
    return message


def test_an_overtaken_state_is_refused_and_leaves_the_velocity_estimate_alone() -> None:
    straight, shuffled = (JointStateReader(["elbow"], ControlConfig()) for _ in range(2))
    for ms in (0, 4, 8, 12):
        expected = straight.read(joint_state(ms, 1e-3 * ms))
        found = shuffled.read(joint_state(ms, 1e-3 * ms))
        if ms > 4:
            with pytest.raises(StateError, match=r"0\.004 s older than one that came before it"):
                shuffled.read(joint_state(ms - 4, 7.0))
    np.testing.assert_array_equal(found.velocity_rad_s, expected.velocity_rad_s)
    assert abs(expected.velocity_rad_s[0]) > 0.5


def test_a_message_that_cannot_be_used_does_not_count_as_the_newest() -> None:
    reader = JointStateReader(["elbow"], ControlConfig())
    reader.read(joint_state(0, 0.0))
    broken = joint_state(50, 0.0)
    broken.position = []
    with pytest.raises(StateError, match="1 names, 0 positions"):
        reader.read(broken)
    assert reader.read(joint_state(4, 0.0)).time_ns == 4_000_000
