"""The brake: without a load it only takes energy out; with one it holds."""

from __future__ import annotations

import numpy as np
import pytest
from two_link import TwoLinkArm

from tel_ros.core.control.brake import SpringBrake
from tel_ros.core.control.ep_law import EpLaw

DT_S = 0.002
UNDAMPED = EpLaw(np.full(2, 15.0), np.zeros(2))
PAPER = EpLaw(np.full(2, 15.0), np.full(2, 1.5))


def brake(arm: TwoLinkArm, law: EpLaw, duration_s: float) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Return position, velocity and effort at each tick of braking an arm."""
    one_way = SpringBrake(np.array(arm.q), np.zeros(2))
    record = []
    for _ in range(round(duration_s / DT_S)):
        q, v = np.array(arm.q), np.array(arm.v)
        effort = law.effort(one_way.equilibrium(q, v), q, v)
        record.append((q, v, effort))
        arm.step(effort, DT_S)
    return record


def random_arm(seed: int) -> TwoLinkArm:
    rng = np.random.default_rng(seed)
    return TwoLinkArm(
        q=tuple(rng.uniform(-2.0, 2.0, 2)),
        v=tuple(rng.uniform(-8.0, 8.0, 2)),
        friction_nms_per_rad=0.0,
        inertia_scale=float(rng.uniform(0.3, 3.0)),
    )


@pytest.mark.parametrize("law", [UNDAMPED, PAPER], ids=["springs_alone", "springs_and_dampers"])
@pytest.mark.parametrize("seed", range(5))
def test_no_joint_is_ever_pulled_along_its_motion(law: EpLaw, seed: int) -> None:
    record = brake(random_arm(seed), law, 2.0)
    power_w = np.array([effort * v for _, v, effort in record])
    assert np.all(power_w <= 0.0)
    assert power_w.min() < -1.0, "nothing was braked at all"


@pytest.mark.parametrize("seed", range(5))
def test_a_moving_arm_comes_to_rest_and_stays_where_it_stopped(seed: int) -> None:
    arm = random_arm(seed)
    before_j = arm.kinetic_energy()
    record = brake(arm, PAPER, 4.0)
    # A heavy joint that creeps along with its own damper alone slows down with I / B < 1 s.
    assert arm.kinetic_energy() < 1e-3 * before_j
    assert np.abs(record[-1][0] - record[-250][0]).max() < 0.02


def test_a_spring_does_not_fling_a_joint_back() -> None:
    """One joint in effect: a latched spring alone would give the whole motion back, turned round."""
    arm = TwoLinkArm(q=(0.0, 1.0), v=(3.0, 0.0), friction_nms_per_rad=0.0)
    record = brake(arm, UNDAMPED, 3.0)
    fastest_back = -min(v[0] for _, v, _ in record)
    assert fastest_back < 0.5, "the shoulder swings back at more than what the elbow's swing gives it"


def test_each_joint_is_braked_on_its_own() -> None:
    one_way = SpringBrake(np.array([0.0, 0.0]), np.zeros(2))
    # The first joint has moved on in the direction of its motion: its spring pulls back, and stays.
    # The second moves towards its equilibrium point: it takes it along.
    one_way.equilibrium(np.array([0.1, 0.1]), np.array([1.0, 1.0]))
    u = one_way.equilibrium(np.array([0.2, 0.08]), np.array([1.0, -1.0]))
    assert u.tolist() == [0.0, 0.08]


def test_the_brake_does_not_follow_the_array_that_it_was_given() -> None:
    position = np.array([0.5, 0.5])
    one_way = SpringBrake(position, np.zeros(2))
    position += 1.0
    assert one_way.equilibrium(np.array([0.6, 0.6]), np.array([1.0, 1.0])).tolist() == [0.5, 0.5]


@pytest.mark.parametrize("known", [1.0, 0.7, 0.0], ids=["load_known", "load_of_another_posture", "unknown"])
def test_under_a_weight_the_arm_is_held_where_it_was_stopped(known: float) -> None:
    """A constant pull of 3 N·m at the shoulder; what the springs give way by is 0.2 rad."""
    arm = TwoLinkArm(q=(0.6, 1.3), v=(1.5, -1.0), push=lambda t: (-3.0, 0.0))
    load = known * np.array([0.2, 0.0]) if known else None
    spring = SpringBrake(np.array(arm.q), load)
    furthest = 0.0
    for _ in range(2000):
        q, v = np.array(arm.q), np.array(arm.v)
        arm.step(PAPER.effort(spring.equilibrium(q, v), q, v), DT_S)
        furthest = max(furthest, abs(arm.q[0] - 0.6))
    assert abs(arm.v[0]) < 0.05  # what counts as rest, and is latched then
    # The swing out of 1.5 rad/s is about 0.15 rad; without a known load the arm gives way as well.
    assert furthest < (0.35 if known else 0.6)


def test_a_spring_with_a_load_gives_back_half_of_its_deflection_at_most() -> None:
    spring = SpringBrake(np.zeros(1), np.array([0.2]))
    assert spring.equilibrium(np.array([0.0]), np.array([1.0])).tolist() == [0.2]
    assert spring.equilibrium(np.array([0.4]), np.array([0.1])).tolist() == [0.2]
    turned = spring.equilibrium(np.array([0.4]), np.array([-0.1]))
    np.testing.assert_allclose(turned, [0.4 + 0.2 - 0.5 * 0.4])


def test_at_rest_the_springs_stay_as_they_are() -> None:
    spring = SpringBrake(np.zeros(2), np.zeros(2))
    latched = spring.equilibrium(np.array([0.1, 0.1]), np.array([1.0, 1.0]))
    still = spring.equilibrium(np.array([-0.1, 0.2]), np.array([0.3, -0.3]), at_rest=True)
    np.testing.assert_array_equal(still, latched)
