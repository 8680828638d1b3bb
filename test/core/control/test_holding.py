"""Coming to rest: the brake takes energy out, holds a load, and rest is told from motion."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from two_link import TwoLinkArm

from tel_ros.core.control.holding import RestDetector, SpringBrake
from tel_ros.core.springs import Springs
from tel_ros.core.types import NS_PER_S

DT_S = 0.002
UNDAMPED = Springs(np.full(2, 15.0), np.zeros(2))
PAPER = Springs(np.full(2, 15.0), np.full(2, 1.5))


def brake(arm: TwoLinkArm, law: Springs, duration_s: float) -> list[tuple[np.ndarray, ...]]:
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
def test_no_joint_is_ever_pulled_along_its_motion(law: Springs, seed: int) -> None:
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


SPEED_RAD_S, WINDOW_S, RATE_HZ = 0.05, 0.2, 500.0


def first_rest_s(
    position_rad: Callable[[float], float], until_s: float = 5.0, start_s: float = 0.0
) -> float | None:
    """Return when a joint first counts as at rest (a second one stands still), or None."""
    detector = RestDetector(SPEED_RAD_S, WINDOW_S)
    for k in range(round(until_s * RATE_HZ)):
        time_s = k / RATE_HZ
        if detector.at_rest(round((start_s + time_s) * NS_PER_S), np.array([1.0, position_rad(time_s)])):
            return time_s
    return None


@pytest.mark.parametrize("start_s", [0.0, 1.7e9], ids=["from_zero", "since_1970"])
def test_an_arm_that_stands_still_is_at_rest_after_the_window_and_not_before(start_s: float) -> None:
    # Stamps are whole nanoseconds but 1.7e9 s as a float is only good to 0.2 µs: the tick after is as right.
    assert first_rest_s(lambda t: 0.3, start_s=start_s) == pytest.approx(WINDOW_S, abs=1.1 / RATE_HZ)


def test_the_noise_of_an_encoder_does_not_count_as_motion() -> None:
    step = 2 * np.pi / 2**12  # 1.5 mrad; differences of successive readings are up to 0.77 rad/s
    rng = np.random.default_rng(0)
    rest_s = first_rest_s(lambda t: round((0.3 + rng.normal(0.0, step)) / step) * step)
    assert rest_s == pytest.approx(WINDOW_S)


@pytest.mark.parametrize("factor", [1.1, 3.0, -1.1])
def test_a_slow_drift_above_the_speed_is_never_rest(factor: float) -> None:
    assert first_rest_s(lambda t: factor * SPEED_RAD_S * t) is None


def test_a_drift_below_the_speed_counts_as_rest() -> None:
    assert first_rest_s(lambda t: 0.9 * SPEED_RAD_S * t) == pytest.approx(WINDOW_S)


def test_a_swing_through_the_same_place_is_not_rest() -> None:
    """The default arm rings at about 1 Hz and stands still for a moment at each turn."""
    assert first_rest_s(lambda t: 0.1 * np.sin(2 * np.pi * t)) is None


def test_the_window_begins_anew_after_a_motion() -> None:
    detector = RestDetector(SPEED_RAD_S, WINDOW_S)
    seen = [
        detector.at_rest(round(time_s * NS_PER_S), np.array([position]))
        for time_s, position in [(0.0, 0.0), (0.15, 0.0), (0.16, 0.5), (0.25, 0.5), (0.35, 0.5), (0.36, 0.5)]
    ]
    assert seen == [False, False, False, False, False, True]


def test_a_clock_that_was_set_back_begins_the_window_anew() -> None:
    detector = RestDetector(SPEED_RAD_S, WINDOW_S)
    seen = [
        detector.at_rest(round(time_s * NS_PER_S), np.array([0.0]))
        for time_s in (100.0, 100.2, 50.0, 50.1, 50.2)
    ]
    assert seen == [False, True, False, False, True]
