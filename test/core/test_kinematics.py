"""Forward kinematics of serial arms."""

from __future__ import annotations

import numpy as np
import pytest

from tel_ros.core.kinematics import ChainJoint, SerialChain

Z = np.array([0.0, 0.0, 1.0])


def joint(
    axis: np.ndarray,
    index: int | None,
    xyz: tuple[float, float, float] = (0, 0, 0),
    roll_rad: float = 0.0,
    *,
    prismatic: bool = False,
) -> ChainJoint:
    return ChainJoint(np.array(xyz, dtype=float), np.array([roll_rad, 0.0, 0.0]), axis, index, prismatic)


def about_x(angle_rad: float) -> np.ndarray:
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([[1, 0, 0], [0, c, -s], [0, s, c]])


def about_z(angle_rad: float) -> np.ndarray:
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])


def two_link(first: int = 0, second: int = 1) -> SerialChain:
    return SerialChain(
        (
            joint(Z, first, (0, 0, 0.1)),
            joint(Z, second, (0.33, 0, 0)),
            joint(Z, None, (0.25, 0, 0)),
        )
    )


def postures(n_joints: int) -> np.ndarray:
    return np.random.default_rng(0).uniform(-np.pi, np.pi, (20, n_joints))


def test_the_hand_of_a_two_link_arm_is_where_the_formula_says() -> None:
    q = postures(2)
    both = q.sum(axis=1)
    expected = np.column_stack(
        [
            0.33 * np.cos(q[:, 0]) + 0.25 * np.cos(both),
            0.33 * np.sin(q[:, 0]) + 0.25 * np.sin(both),
            np.full(20, 0.1),
        ]
    )
    np.testing.assert_allclose(two_link().hand_positions(q), expected, atol=1e-14)  # rounding only


def test_joints_may_come_in_another_order_than_in_the_chain() -> None:
    q = postures(2)
    np.testing.assert_array_equal(two_link(1, 0).hand_positions(q[:, ::-1]), two_link().hand_positions(q))


def test_a_prismatic_joint_slides_along_its_axis_in_the_frame_of_its_link() -> None:
    chain = SerialChain(
        (
            joint(Z, 0),
            joint(np.array([1.0, 0.0, 0.0]), 1, (0.5, 0, 0), prismatic=True),
        )
    )
    hand = chain.hand_positions(np.array([[np.pi / 2, 0.2], [0.0, -0.1]]))
    np.testing.assert_allclose(hand, [[0.0, 0.7, 0.0], [0.4, 0.0, 0.0]], atol=1e-14)


def test_a_turned_origin_turns_everything_behind_it() -> None:
    """The second axis is tipped by 90° about x: turning about it lifts the hand out of the plane."""
    chain = SerialChain(
        (
            joint(Z, 0),
            joint(Z, 1, (0.4, 0, 0), np.pi / 2),
            joint(Z, None, (0.3, 0, 0)),
        )
    )
    q = postures(2)
    expected = [about_z(a) @ ([0.4, 0, 0] + about_x(np.pi / 2) @ about_z(b) @ [0.3, 0, 0]) for a, b in q]
    np.testing.assert_allclose(chain.hand_positions(q), expected, atol=1e-14)


@pytest.mark.parametrize("angle_rad", [0.0, 0.7, -2.0])
def test_a_joint_turns_about_any_axis_by_the_right_hand_rule(angle_rad: float) -> None:
    axis = np.array([1.0, 1.0, 1.0]) / np.sqrt(3.0)
    chain = SerialChain((joint(axis, 0), joint(Z, None, (1.0, 0, 0))))
    x = np.array([1.0, 0.0, 0.0])
    rodrigues = (
        x * np.cos(angle_rad)
        + np.cross(axis, x) * np.sin(angle_rad)
        + axis * (axis @ x) * (1 - np.cos(angle_rad))
    )
    np.testing.assert_allclose(chain.hand_positions(np.array([[angle_rad]])), [rodrigues], atol=1e-14)
