"""The law of the stand-in for the joint_trajectory_controller: what it commands, gives up, says and holds."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import BPoly, CubicHermiteSpline

from sim_bridge.splines import Points, points_of
from sim_bridge.trajectory_control import (
    CANCELLED,
    LEFT_THE_PATH,
    PREEMPTED,
    REACHED,
    Code,
    Gains,
    Tolerances,
    TrajectoryController,
)
from tel_ros.core.errors import TrajectoryError
from tel_ros.core.types import NS_PER_S, FloatArray

JOINTS = ("shoulder", "elbow")
RATE_HZ = 100.0
PERIOD_NS = round(NS_PER_S / RATE_HZ)
BEGIN_NS = 5 * NS_PER_S
STIFF, DAMP = np.array([15.0, 10.0]), np.array([1.5, 0.5])
TIME_S = np.array([0.0, 0.3, 0.5, 1.0])
RNG = np.random.default_rng(4)
Y, DY, DDY, EFFORT = (RNG.normal(size=(4, 2)) for _ in range(4))
DY[-1] = 0.0
FREE = Tolerances.of((0.0, 0.0), (0.0, 0.0), 0.0, 0.0)


def stamp(seconds: float) -> SimpleNamespace:
    sec, nanosec = divmod(round(seconds * NS_PER_S), NS_PER_S)
    return SimpleNamespace(sec=sec, nanosec=nanosec)


def trajectory(start_s: float = 0.0, joints: tuple[str, ...] = JOINTS, **fields: FloatArray) -> Any:
    """Return a JointTrajectory at ``TIME_S``; ``fields`` of its points."""
    points = [
        SimpleNamespace(
            time_from_start=stamp(t),
            **{
                name: fields[name][k].tolist() if name in fields else []
                for name in ("positions", "velocities", "accelerations", "effort")
            },
        )
        for k, t in enumerate(TIME_S)
    ]
    return SimpleNamespace(
        header=SimpleNamespace(stamp=stamp(start_s)), joint_names=list(joints), points=points
    )


def tolerated(**values: Any) -> Any:
    given = {"path_tolerance": [], "goal_tolerance": [], "goal_time_tolerance": stamp(0.0), **values}
    return SimpleNamespace(**given)


def tolerance(joint: str, position: float = 0.0, velocity: float = 0.0) -> Any:
    return SimpleNamespace(name=joint, position=position, velocity=velocity, acceleration=0.0)


def controller(**options: Any) -> TrajectoryController:
    zero = np.zeros(2)
    made = TrajectoryController(JOINTS, RATE_HZ, Gains(STIFF, zero, DAMP, zero), **options)
    made.update(BEGIN_NS - PERIOD_NS, (0.0, 0.0), (0.0, 0.0))
    return made


def ticks(duration_s: float) -> list[int]:
    return [BEGIN_NS + k * PERIOD_NS for k in range(round(duration_s * RATE_HZ))]


def full() -> Points:
    fields = {"positions": Y, "velocities": DY, "accelerations": DDY, "effort": EFFORT}
    return points_of(trajectory(**fields), JOINTS, BEGIN_NS)


@pytest.mark.parametrize(
    ("fields", "spline"),
    [
        ({"positions": Y}, lambda t: np.column_stack([np.interp(t, TIME_S, y) for y in Y.T])),
        ({"positions": Y, "velocities": DY}, CubicHermiteSpline(TIME_S, Y, DY)),
        (
            {"positions": Y, "velocities": DY, "accelerations": DDY},
            BPoly.from_derivatives(TIME_S, np.stack([Y, DY, DDY], axis=1)),
        ),
    ],
    ids=["lines", "cubic", "quintic"],
)
def test_the_command_is_the_spring_to_the_spline_and_the_effort_of_one_period_later(
    fields: dict[str, FloatArray], spline: Any
) -> None:
    law = controller()
    law.follow(points_of(trajectory(**fields, effort=EFFORT), JOINTS, BEGIN_NS), FREE)
    for time_ns in ticks(1.2):
        q, dq = RNG.normal(size=2), RNG.normal(size=2)
        law.update(time_ns, q, dq)
        t = (time_ns - BEGIN_NS) / NS_PER_S
        now, ahead = min(t, 1.0), min(t + 1.0 / RATE_HZ, 1.0)
        np.testing.assert_allclose(law.desired[0], np.squeeze(spline([now])), atol=1e-9)
        feed_forward = [np.interp(ahead, TIME_S, each) for each in EFFORT.T]
        wanted = feed_forward + STIFF * (law.desired[0] - q) + DAMP * (law.desired[1] - dq)
        np.testing.assert_allclose(law.effort_nm, wanted, atol=1e-9)


def test_velocities_and_accelerations_are_derivatives_of_the_positions() -> None:
    law = controller()
    law.follow(full(), FREE)
    told = []
    for time_ns in ticks(1.0):
        law.update(time_ns, (0.0, 0.0), (0.0, 0.0))
        told.append(law.desired.copy())
    position, velocity, acceleration, _ = np.moveaxis(np.array(told), 1, 0)
    inside = np.s_[5:25]  # of one segment
    for of, derivative in ((position, velocity), (velocity, acceleration)):
        numeric = np.gradient(of, 1.0 / RATE_HZ, axis=0)
        np.testing.assert_allclose(numeric[inside], derivative[inside], rtol=0.02, atol=0.2)


def test_with_gains_k_and_b_it_is_the_equilibrium_point_law() -> None:
    """Effort K (û - y) - B ẏ makes K (û - q) - B q̇ of it, whatever the state."""
    u = RNG.normal(size=(4, 2))
    law = controller()
    points = points_of(
        trajectory(positions=Y, velocities=DY, effort=STIFF * (u - Y) - DAMP * DY), JOINTS, BEGIN_NS
    )
    law.follow(points, FREE)
    for k, t in enumerate(TIME_S):
        q, dq = RNG.normal(size=2), RNG.normal(size=2)
        # Its effort is that of one period later: the state of a point, and the effort of that point.
        law.update(BEGIN_NS + round(t * NS_PER_S), q, dq)
        at_point = law.effort_nm - law._sample(law.time_ns + PERIOD_NS)[3] + points.values[k, 3]
        np.testing.assert_allclose(at_point, STIFF * (u[k] - q) - DAMP * dq, atol=1e-9)


def test_the_way_to_a_first_point_in_the_future_begins_where_the_arm_is_with_its_effort() -> None:
    law = controller()
    law.effort_nm = np.array([3.0, -2.0])
    fields = {"positions": Y, "velocities": DY, "accelerations": DDY, "effort": EFFORT}
    law.follow(points_of(trajectory(5.5, **fields), JOINTS, BEGIN_NS), FREE)
    q, dq = np.array([0.4, -0.2]), np.array([0.1, 0.3])
    law.update(BEGIN_NS, q, dq)
    np.testing.assert_allclose(law.desired, [q, dq, [0.0, 0.0], [3.0, -2.0]], atol=1e-12)
    law.update(BEGIN_NS + NS_PER_S // 4, q, dq)
    way = BPoly.from_derivatives([0.0, 0.5], np.array([[q, dq, np.zeros(2)], [Y[0], DY[0], DDY[0]]]))
    np.testing.assert_allclose(law.desired[0], way(0.25), atol=1e-12)
    np.testing.assert_allclose(law.desired[3], 0.5 * (np.array([3.0, -2.0]) + EFFORT[0]), atol=1e-12)
    law.update(BEGIN_NS + NS_PER_S // 2, q, dq)
    np.testing.assert_allclose(law.desired[:, :], [Y[0], DY[0], DDY[0], EFFORT[0]], atol=1e-12)


def test_a_trajectory_may_begin_where_the_one_before_has_sent_the_arm() -> None:
    law = controller(starts_from_command=True)
    law.follow(full(), FREE)
    for time_ns in ticks(0.2):
        law.update(time_ns, (9.0, 9.0), (0.0, 0.0))
    ahead = law._sample(BEGIN_NS + 20 * PERIOD_NS).copy()
    law.follow(points_of(trajectory(5.5, positions=Y, velocities=DY), JOINTS, BEGIN_NS), FREE)
    law.update(BEGIN_NS + 20 * PERIOD_NS, (9.0, 9.0), (0.0, 0.0))
    assert np.max(np.abs(law.desired[0] - ahead[0])) < 0.2  # and not at 9, where the arm is


def run(
    law: TrajectoryController, points: Points, tolerances: Tolerances, off: FloatArray, end_s: float
) -> Any:
    """Follow with an arm that is off by so much, and return when and how it ends."""
    law.follow(points, tolerances)
    for time_ns in ticks(end_s):
        desired = law._sample(time_ns)[:2] if law.has_goal and law._next is None else points.values[0, :2]
        if ended := law.update(time_ns, *(desired - off)):
            return (time_ns - BEGIN_NS) / NS_PER_S, ended
    return None


NEAR = Tolerances.of((0.1, 0.2), (0.05, 0.05), 0.01, 0.3)
NOTHING = np.zeros((2, 2))


def test_a_goal_that_is_reached_ends_with_its_last_point_held_with_effort() -> None:
    law = controller()
    at_s, ended = run(law, full(), NEAR, NOTHING, 2.0)
    assert ended == REACHED and ended.text == "Goal successfully reached!"
    assert at_s == pytest.approx(1.0, abs=1.5 / RATE_HZ)
    law.update(BEGIN_NS + 3 * NS_PER_S, Y[-1] + 5.0, (0.0, 0.0))
    np.testing.assert_allclose(law.effort_nm, EFFORT[-1] - 5.0 * STIFF)
    assert not law.has_goal and not law.moves


def test_a_path_tolerance_is_for_one_joint_and_its_violation_holds_the_arm_without_effort() -> None:
    law = controller()
    assert run(law, full(), NEAR, np.array([[0.09, 0.19], [3.0, 3.0]]), 0.9) is None
    law = controller()
    at_s, ended = run(law, full(), NEAR, np.array([[0.0, 0.21], [0.0, 0.0]]), 2.0)
    assert (at_s, ended.code, ended.text) == (0.0, Code.PATH_TOLERANCE_VIOLATED, LEFT_THE_PATH)
    assert "position of elbow is off by 0.210000 rad (tolerance 0.2)" in ended.why
    where = Y[0] - [0.0, 0.21]
    law.update(BEGIN_NS + PERIOD_NS, where + 0.01, (0.0, 0.0))
    np.testing.assert_allclose(law.effort_nm, -0.01 * STIFF)
    assert law.holding and not law.moves


def test_the_period_of_a_violation_repeats_the_command_before() -> None:
    law = controller()
    law.follow(full(), NEAR)
    law.update(BEGIN_NS, *Points.hold(Y[0]).values[0, :2])
    before = law.effort_nm.copy()
    assert law.update(BEGIN_NS + PERIOD_NS, Y[0] + 3.0, DY[0]).code == Code.PATH_TOLERANCE_VIOLATED
    np.testing.assert_array_equal(law.effort_nm, before)


@pytest.mark.parametrize(
    "off", [[[0.06, 0.0], [0.0, 0.0]], [[0.0, 0.0], [0.0, 0.02]]], ids=["place", "speed"]
)
def test_a_goal_that_is_not_reached_in_its_time_is_given_up(off: list[list[float]]) -> None:
    at_s, ended = run(controller(), full(), NEAR, np.array(off), 3.0)
    assert ended.code == Code.GOAL_TOLERANCE_VIOLATED
    assert at_s == pytest.approx(1.3, abs=1.5 / RATE_HZ)
    assert ended.text == f"Aborted due to goal_time_tolerance exceeding by {at_s - 1.0:.6f} seconds"


def test_without_a_goal_time_it_waits_for_ever_and_then_succeeds() -> None:
    law, patient = controller(), Tolerances.of((0.1, 0.2), (0.05, 0.05), 0.01, 0.0)
    assert run(law, full(), patient, np.array([[0.06, 0.0], [0.0, 0.0]]), 5.0) is None
    assert law.update(BEGIN_NS + 6 * NS_PER_S, Y[-1], (0.0, 0.0)) == REACHED


def test_cancelling_holds_the_arm_where_it_is() -> None:
    law = controller()
    law.follow(full(), NEAR)
    law.update(BEGIN_NS, Y[0], DY[0])
    assert law.cancel() == CANCELLED
    assert law.update(BEGIN_NS + PERIOD_NS, Y[0] + 3.0, (0.0, 0.0)) is None
    np.testing.assert_allclose(law.effort_nm, -3.0 * STIFF)


def test_a_hold_has_the_efforts_with_which_the_last_goal_was_reached() -> None:
    law = controller()
    assert run(law, full(), NEAR, np.zeros((2, 2)), 1.5)[1] == REACHED
    law.follow(full(), NEAR)
    law.update(BEGIN_NS + 3 * NS_PER_S, Y[0], DY[0])
    assert law.cancel() == CANCELLED
    law.update(BEGIN_NS + 3 * NS_PER_S + PERIOD_NS, Y[0] + 0.1, (0.0, 0.0))
    np.testing.assert_allclose(law.effort_nm, EFFORT[-1] - 0.1 * STIFF)


def test_a_new_goal_ends_the_one_before_and_is_followed_from_the_next_state() -> None:
    law = controller()
    assert law.follow(full(), NEAR) is None
    law.update(BEGIN_NS, Y[0], DY[0])
    ended = law.follow(points_of(trajectory(positions=Y + 1.0), JOINTS, BEGIN_NS), NEAR)
    assert ended == PREEMPTED and ended.code == Code.INVALID_GOAL
    assert ended.text == "Current goal preempted by new incoming action."
    law.update(BEGIN_NS + PERIOD_NS, Y[0] + 1.0, (0.0, 0.0))
    np.testing.assert_allclose(law.desired[0], Y[0] + 1.0)
    assert law.has_goal


def test_tolerances_of_a_goal_change_those_that_are_configured() -> None:
    asked = tolerated(
        path_tolerance=[tolerance("elbow", 0.5, 2.0)],
        goal_tolerance=[tolerance("shoulder", -1.0)],
        goal_time_tolerance=stamp(0.7),
    )
    changed = NEAR.asked_for(asked, JOINTS)
    np.testing.assert_array_equal(changed.path, [[0.1, 0.5], [np.inf, 2.0]])
    np.testing.assert_array_equal(changed.goal, [[np.inf, 0.05], [0.01, 0.01]])
    assert changed.goal_time_s == 0.7 and not changed.remarks
    erased = NEAR.asked_for(tolerated(goal_time_tolerance=stamp(-1.0)), JOINTS)
    assert erased.goal_time_s == 0.0


@pytest.mark.parametrize(
    "wrong", [tolerance("wrist", 0.1), tolerance("elbow", -0.5), tolerance("elbow", np.nan)]
)
def test_tolerances_that_make_no_sense_leave_all_as_configured(wrong: Any) -> None:
    same = NEAR.asked_for(tolerated(path_tolerance=[tolerance("shoulder", 9.0), wrong]), JOINTS)
    np.testing.assert_array_equal(same.path, NEAR.path)
    assert "the tolerances that are configured" in same.remarks[0]


def test_joints_are_taken_by_their_names() -> None:
    turned = points_of(
        trajectory(joints=JOINTS[::-1], positions=Y[:, ::-1], velocities=DY[:, ::-1]), JOINTS, 0
    )
    straight = points_of(trajectory(positions=Y, velocities=DY), JOINTS, 0)
    np.testing.assert_array_equal(turned.values, straight.values)


def bad(change: str) -> Any:
    message = trajectory(positions=Y, velocities=DY, effort=EFFORT)
    point = message.points[1]
    if change == "other joints":
        message.joint_names = ["shoulder", "wrist"]
    elif change == "a joint less":
        message.joint_names = ["shoulder"]
    elif change == "a joint twice":
        message.joint_names = ["shoulder", "shoulder"]
    elif change == "no points":
        message.points = []
    elif change == "times":
        point.time_from_start = message.points[2].time_from_start
    elif change == "past":
        message.header.stamp = stamp(3.0)
    elif change == "moving":
        message.points[-1].velocities = [0.0, 0.1]
    elif change == "lengths":
        point.velocities = [0.0]
    elif change == "efforts":
        point.effort = [0.0] * 3
    elif change == "no positions":
        point.positions = []
    elif change == "nan":
        point.effort = [np.nan, 0.0]
    else:
        point.velocities, point.accelerations = [], [0.0, 0.0]
    return message


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ("other joints", "'wrist'"),
        ("a joint less", "joints of the trajectory: ['shoulder']"),
        ("a joint twice", "each of ['shoulder', 'elbow'] once"),
        ("no points", "no points"),
        ("times", "do not increase"),
        ("past", "ended 1.000 s ago"),
        ("moving", "ends in motion: velocities [0.0, 0.1]"),
        ("lengths", "point 1 has 1 velocities"),
        ("efforts", "point 1 has 3 effort"),
        ("no positions", "point 1 has 0 positions"),
        ("nan", "effort of point 1 are [nan, 0.0]"),
        ("accelerations alone", "accelerations without velocities"),
    ],
)
def test_a_trajectory_that_cannot_be_followed_is_refused_with_the_reason(change: str, said: str) -> None:
    with pytest.raises(TrajectoryError) as refused:
        points_of(bad(change), JOINTS, BEGIN_NS)
    assert said in str(refused.value)


def test_a_trajectory_whose_end_is_still_to_come_is_joined_in_the_middle() -> None:
    law = controller()
    law.follow(points_of(trajectory(4.6, positions=Y, velocities=DY), JOINTS, BEGIN_NS), FREE)
    law.update(BEGIN_NS, Y[0], DY[0])
    np.testing.assert_allclose(law.desired[0], CubicHermiteSpline(TIME_S, Y, DY)(0.4), atol=1e-12)
