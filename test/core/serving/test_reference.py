"""What is taken for a trajectory of the arm, and how the arm goes through its points."""

from __future__ import annotations

import numpy as np
import pytest

from tel_ros.core.control.trajectory_points import ErrorCode
from tel_ros.core.serving.reference import Points, Reference, RefusedError, requested
from tel_ros.core.types import NS_PER_S

JOINTS = ("shoulder", "elbow")
HERE = np.array([0.1, -0.2])


def points(*times_s: float, **columns: list[list[float]]) -> Points:
    rows = [[] for _ in times_s]
    names = ("positions", "velocities", "accelerations")
    named = columns.pop("named", JOINTS)
    times_ns = [round(t * NS_PER_S) for t in times_s]
    return requested(JOINTS, named, times_ns, *(columns.get(name, rows) for name in names))


def test_joints_may_come_in_any_order() -> None:
    found = points(0.0, 1.0, positions=[[1.0, 2.0], [3.0, 4.0]], named=("elbow", "shoulder"))
    np.testing.assert_array_equal(found.position_rad, [[2.0, 1.0], [4.0, 3.0]])


@pytest.mark.parametrize(
    ("times_s", "columns", "said", "code"),
    [
        ((1.0,), {"positions": [[1.0, 2.0]], "named": ("wrist", "elbow")}, "wrist, elbow", "INVALID_JOINTS"),
        ((1.0,), {"positions": [[1.0]], "named": ("elbow",)}, "don't match", "INVALID_JOINTS"),
        ((1.0,), {"positions": [[1.0, 2.0]], "named": ()}, "Empty joint names", "INVALID_JOINTS"),
        ((), {"positions": []}, "Empty trajectory", "INVALID_GOAL"),
        ((1.0,), {"positions": [[1.0, np.nan]]}, "elbow is nan", "INVALID_GOAL"),
        ((1.0,), {"positions": [[1.0, 2.0]], "velocities": [[0.0, np.inf]]}, "elbow is inf", "INVALID_GOAL"),
        ((1.0,), {"positions": [[1.0]]}, "point 0 has 1 positions; expected 2", "INVALID_GOAL"),
        (
            (1.0, 2.0),
            {"positions": [[1.0, 2.0]] * 2, "velocities": [[0.0, 0.0], []]},
            "point 1 has 0 velocities; expected 2, or none in any point",
            "INVALID_GOAL",
        ),
        ((1.0, 1.0), {"positions": [[1.0, 2.0]] * 2}, "not strictly increasing", "INVALID_GOAL"),
        ((-1.0, 1.0), {"positions": [[1.0, 2.0]] * 2}, "first point is at -1.0 s", "INVALID_GOAL"),
        (
            (1.0,),
            {"positions": [[1.0, 2.0]], "velocities": [[0.0, 0.3]]},
            "Velocity of last trajectory point of joint elbow is not zero: 0.3",
            "INVALID_GOAL",
        ),
    ],
)
def test_what_is_no_trajectory_of_the_arm_is_refused_with_the_reason(times_s, columns, said, code) -> None:  # noqa: ANN001
    with pytest.raises(RefusedError, match=said) as refusal:
        points(*times_s, **columns)
    assert refusal.value.code == ErrorCode[code]


def test_a_single_point_is_a_minimum_jerk_movement_from_where_the_arm_is() -> None:
    desired = Reference(points(2.0, positions=[[1.1, -0.2]]), HERE).desired(1.0, 100.0)
    s = desired.time_s / 2.0
    np.testing.assert_allclose(
        desired.position_rad[:, 0], HERE[0] + 10 * s**3 - 15 * s**4 + 6 * s**5, atol=1e-12
    )
    np.testing.assert_allclose(desired.position_rad[:, 1], HERE[1], atol=1e-12)


def sampled(every: float) -> Points:
    """Return a smooth movement as planners give it."""
    t = np.arange(0.0, 2.0 + 1e-9, every)
    q = 0.5 * (1 - np.cos(np.pi * t / 2))[:, None] * [1.0, -0.5]
    dq = 0.25 * np.pi * np.sin(np.pi * t / 2)[:, None] * [1.0, -0.5]
    ddq = 0.125 * np.pi**2 * np.cos(np.pi * t / 2)[:, None] * [1.0, -0.5]
    return Points(np.round(t * NS_PER_S).astype(np.int64), q, dq, ddq)


@pytest.mark.parametrize("given", ["positions", "velocities", "accelerations"])
def test_whatever_points_give_the_reference_is_the_movement_that_they_were_taken_from(given) -> None:  # noqa: ANN001
    full = sampled(0.1)
    velocity = None if given == "positions" else full.velocity_rad_s
    acceleration = full.acceleration_rad_s2 if given == "accelerations" else None
    reference = Reference(Points(full.time_ns, full.position_rad, velocity, acceleration), HERE)
    desired, exact = reference.desired(1.0, 100.0), sampled(0.01)
    np.testing.assert_allclose(desired.position_rad, exact.position_rad, atol=2e-3)
    assert exact.velocity_rad_s is not None and exact.acceleration_rad_s2 is not None
    middle = slice(20, -20)
    np.testing.assert_allclose(desired.velocity_rad_s[middle], exact.velocity_rad_s[middle], atol=5e-3)
    np.testing.assert_allclose(
        desired.acceleration_rad_s2[middle], exact.acceleration_rad_s2[middle], atol=0.03
    )
    # No jumps: what an effort cannot follow would be one of more than the movement's own change.
    assert np.abs(np.diff(desired.velocity_rad_s, axis=0)).max() < 0.05


def test_a_slower_movement_goes_the_same_way_and_takes_the_square_of_the_effort_less() -> None:
    reference = Reference(sampled(0.1), HERE)
    fast, slow = reference.desired(1.0, 100.0), reference.desired(2.0, 50.0)
    np.testing.assert_allclose(slow.position_rad, fast.position_rad, atol=1e-12)
    np.testing.assert_allclose(2.0 * slow.velocity_rad_s, fast.velocity_rad_s, atol=1e-12)
    np.testing.assert_allclose(4.0 * slow.acceleration_rad_s2, fast.acceleration_rad_s2, atol=1e-12)
    assert slow.duration_s == 2.0 * fast.duration_s


def test_a_movement_that_ends_between_two_ticks_is_at_rest_at_the_later_one() -> None:
    desired = Reference(points(1.003, positions=[[1.1, -0.2]]), HERE).desired(1.0, 100.0)
    assert desired.duration_s == 1.01
    np.testing.assert_allclose(desired.position_rad[-1], [1.1, -0.2])
    assert not desired.velocity_rad_s[-1].any() and not desired.acceleration_rad_s2[-1].any()


def test_requests_of_the_same_movement_are_known_again() -> None:
    first, again = sampled(0.1), sampled(0.1)
    moved = Points(first.time_ns, first.position_rad + 0.05)
    assert first.key == again.key
    assert first.key != moved.key
    assert first.key != Points(2 * first.time_ns, first.position_rad).key
