"""The gate for joint states: what is refused, and what is told of the others."""

from __future__ import annotations

from contextlib import suppress

import numpy as np
import pytest
from two_link import arm_config

from tel_ros.core.arm_state import ArmState
from tel_ros.core.config import ControlConfig
from tel_ros.core.errors import StateError
from tel_ros.core.safety.gate import Latency, Plausibility, StateGate
from tel_ros.core.types import NS_PER_S

PER_JOINT = (
    "stiffness_nm_per_rad",
    "damping_nms_per_rad",
    "effort_limit_nm",
    "position_max_rad",
    "velocity_limit_rad_s",
)
MS = 1_000_000
EPOCH_NS = 1_790_000_000 * NS_PER_S
"""An arm stamps with the time of day, this machine counts from when it was switched on."""


def heard(latency: Latency, on_the_way_ms: list[float], first_ms: float = 0.0) -> np.ndarray:
    """Return how late states are, in ms, that are measured every 2 ms and are on their way for so long."""
    stamps_ms = first_ms + 2.0 * np.arange(len(on_the_way_ms))
    arrivals_ms = stamps_ms + np.array(on_the_way_ms)
    return np.array(
        [
            1e3 * latency.of(EPOCH_NS + round(s * MS), 5 * NS_PER_S + round(a * MS))
            for s, a in zip(stamps_ms, arrivals_ms, strict=True)
        ]
    )


def test_a_state_is_late_by_what_it_took_longer_than_the_fastest_one_so_far() -> None:
    late_ms = heard(Latency(0.0), [1.0, 1.5, 0.5, 20.5, 0.7])
    np.testing.assert_allclose(late_ms, [0.0, 0.5, 0.0, 20.0, 0.2], atol=1e-3)


def test_after_stamps_that_go_back_lateness_counts_anew() -> None:
    latency = Latency(0.0)
    heard(latency, [1.0, 1.0])
    set_back = heard(latency, [31.0, 31.0, 41.0], first_ms=-500.0)
    np.testing.assert_allclose(set_back, [0.0, 0.0, 10.0], atol=1e-3)


def test_stamps_that_jump_forward_make_nothing_late() -> None:
    latency = Latency(0.0)
    heard(latency, [1.0, 1.0])
    np.testing.assert_allclose(heard(latency, [1.0, 1.0], first_ms=3.6e6), 0.0, atol=1e-3)


@pytest.mark.parametrize("drift", [-0.0005, 0.0005])
def test_a_clock_that_drifts_by_less_than_is_allowed_never_makes_states_late(drift: float) -> None:
    latency = Latency(0.001)
    late_s = [latency.of(EPOCH_NS + round((1.0 - drift) * k * 2 * MS), k * 2 * MS) for k in range(30_000)]
    assert max(late_s) < 1e-5


def test_states_that_stay_late_are_taken_for_punctual_as_slowly_as_a_clock_may_drift() -> None:
    latency = Latency(0.001)
    late_ms = heard(latency, [1.0, *([41.0] * 5000)])
    assert late_ms[1] == pytest.approx(40.0, abs=0.1)
    assert late_ms[-1] == pytest.approx(30.0, abs=0.1)


def test_with_a_simulator_that_is_slower_than_real_time_nothing_is_late_if_that_is_configured() -> None:
    half_speed = Latency(1.0)
    assert max(half_speed.of(k * MS, EPOCH_NS + k * 2 * MS) for k in range(1000)) == 0.0


def gate() -> StateGate:
    arm = arm_config(joints=("elbow",), **dict.fromkeys(PER_JOINT, (2.0,)), position_min_rad=(-2.0,))
    return StateGate(arm, ControlConfig())


def hear(gate: StateGate, stamp_ms: float, position_rad: float = 0.0) -> ArmState:
    return gate.admit(("elbow",), round(stamp_ms * MS), (position_rad,), (), (), arrived_ns=0)


def used(stamps_ms: list[float]) -> list[float]:
    """Return the stamps of the states that are not refused."""
    one, kept = gate(), []
    for stamp_ms in stamps_ms:
        with suppress(StateError):
            hear(one, stamp_ms)
            kept.append(stamp_ms)
    return kept


def test_neighbours_that_change_places_give_the_newer_of_each_two() -> None:
    assert used([0, 8, 4, 16, 12, 20]) == [0, 8, 16, 20]


def test_a_state_that_is_sent_again_is_no_older_one() -> None:
    assert used([0, 4, 4, 4, 8]) == [0, 4, 4, 4, 8]


def test_a_clock_that_was_set_back_counts_from_then_on() -> None:
    assert used([1000, 1004, 904, 908, 912]) == [1000, 1004, 904, 908, 912]  # by the time-out
    assert used([1000, 900.5, 950, 999.5, 1000.5]) == [1000, 1000.5]  # by a little less


def test_an_overtaken_state_is_refused_and_leaves_the_velocity_estimate_alone() -> None:
    straight, shuffled = gate(), gate()
    for ms in (0, 4, 8, 12):
        expected = hear(straight, ms, 1e-3 * ms)
        found = hear(shuffled, ms, 1e-3 * ms)
        if ms > 4:
            with pytest.raises(StateError, match=r"0\.004 s older than one that came before it"):
                hear(shuffled, ms - 4, 7.0)
    np.testing.assert_array_equal(found.velocity_rad_s, expected.velocity_rad_s)
    assert abs(expected.velocity_rad_s[0]) > 0.5


def test_a_message_that_cannot_be_used_does_not_count_as_the_newest() -> None:
    one = gate()
    hear(one, 0, 0.0)
    with pytest.raises(StateError, match="1 names, 0 positions"):
        one.admit(("elbow",), 50 * MS, (), (), (), arrived_ns=0)
    assert hear(one, 4, 0.0).time_ns == 4_000_000


def test_a_broken_position_does_not_disturb_the_velocity_that_is_made_of_positions() -> None:
    one = gate()
    for ms in (0, 4, 8):
        before = hear(one, ms, 1e-3 * ms).velocity_rad_s
    with pytest.raises(StateError, match="elbow has jumped by 1e\\+09 rad"):
        hear(one, 12, 1e9)
    after = hear(one, 16, 1e-3 * 16).velocity_rad_s
    np.testing.assert_allclose(after, before)


def test_a_state_that_is_sent_again_is_the_same_object_and_says_nothing_new() -> None:
    one = gate()
    first = hear(one, 4.0, 0.1)
    assert hear(one, 4.0, 0.1) is first
    assert hear(one, 4.0, 0.9) is first  # whatever it says
    assert hear(one, 8.0, 0.1) is not first


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_state_that_is_not_finite_is_refused_and_the_next_one_is_not(bad: float) -> None:
    one = gate()
    one.admit(("elbow",), 0, (0.0,), (0.0,), (), arrived_ns=0)
    for field in ((bad,), (0.1,)), ((0.0,), (bad,)):
        with pytest.raises(StateError):
            one.admit(("elbow",), 4 * MS, *field, (), arrived_ns=0)
    assert one.admit(("elbow",), 8 * MS, (0.1,), (0.2,), (), arrived_ns=0).velocity_rad_s.tolist() == [0.2]


def test_the_joints_of_the_arm_are_picked_by_name_whatever_else_is_there() -> None:
    both = StateGate(arm_config(), ControlConfig(), clock_drift=0.0)
    seen = both.admit(("gripper", "elbow", "shoulder"), 0, (9.0, 0.2, 0.1), (9.0, 0.4, 0.3), (), 7 * MS)
    assert (seen.position_rad.tolist(), seen.velocity_rad_s.tolist()) == ([0.1, 0.2], [0.3, 0.4])
    assert (seen.effort_nm, seen.age_s) == (None, 0.0)
    later = both.admit(("shoulder", "elbow"), 2 * MS, (0.1, 0.2), (0.3, 0.4), (5.0, 6.0), 14 * MS)
    assert later.effort_nm is not None and later.effort_nm.tolist() == [5.0, 6.0]
    assert later.age_s == pytest.approx(0.005)  # 7 ms on the way at first, 12 ms now
    with pytest.raises(StateError, match="has elbow; expected also shoulder"):
        both.admit(("elbow",), 4 * MS, (0.2,), (), (), 16 * MS)


def test_velocities_that_are_not_reported_are_named() -> None:
    both = StateGate(arm_config(), ControlConfig())
    both.admit(("shoulder", "elbow"), 0, (0.1, 0.2), (0.0, float("nan")), (), 0)
    assert both.estimated == ("elbow",)


def plausibility() -> Plausibility:
    return Plausibility(("shoulder", "elbow"), np.array([2.0, np.inf]), 100 * MS)


@pytest.mark.parametrize("speed", [20.1, -1e12, np.inf])
def test_a_joint_many_times_faster_than_its_limit_is_not_believed(speed: float) -> None:
    with pytest.raises(StateError, match=r"shoulder moves at .* rad/s; expected at most 20 \(10 times"):
        plausibility().require(0, np.zeros(2), np.array([speed, 0.0]))


def test_a_speed_beyond_the_limit_that_a_trial_is_aborted_for_is_believed() -> None:
    plausibility().require(0, np.zeros(2), np.array([-19.9, 1e6]))  # the elbow has no limit


def test_a_jump_that_no_speed_explains_is_passed_over_and_what_follows_is_not() -> None:
    rule, slow = plausibility(), np.array([0.5, 0.0])
    rule.require(0, np.array([0.5, 0.0]), slow)
    with pytest.raises(StateError, match="shoulder has jumped by 0.13 rad; expected at most 0.12"):
        rule.require(4 * MS, np.array([0.63, 0.0]), slow)
    rule.require(8 * MS, np.array([0.51, 0.0]), slow)
    rule.require(12 * MS, np.array([0.62, 0.0]), slow)


def test_where_no_speed_is_told_or_a_huge_one_the_limit_counts() -> None:
    for told in (np.full(2, np.nan), np.array([19.0, 0.0])):
        rule = plausibility()
        rule.require(0, np.zeros(2), told)
        rule.require(4 * MS, np.array([0.17, 0.0]), told)
        with pytest.raises(StateError, match="shoulder has jumped by 0.19 rad; expected at most 0.18"):
            rule.require(8 * MS, np.array([0.36, 0.0]), told)


def test_a_second_voice_that_says_the_arm_rests_elsewhere_is_not_believed_for_a_single_state() -> None:
    rule = plausibility()
    for k in range(0, 100, 2):
        rule.require(4 * k * MS, np.array([0.5 + 0.004 * k, 0.0]), np.array([1.0, 0.0]))
        with pytest.raises(StateError, match="has jumped"):
            rule.require(4 * (k + 1) * MS, np.zeros(2), np.zeros(2))


def test_a_position_that_stays_elsewhere_is_believed_after_the_time_out() -> None:
    rule, still = plausibility(), np.zeros(2)
    rule.require(0, still, still)
    refused = 0
    for ms in range(4, 200, 4):
        try:
            rule.require(ms * MS, np.array([3.0, 0.0]), still)
        except StateError:
            refused += 1
    assert refused == 25  # 0.1 s


def test_what_is_not_a_number_is_left_to_others_and_not_compared_with() -> None:
    rule, still = plausibility(), np.zeros(2)
    rule.require(0, still, still)
    rule.require(4 * MS, np.array([np.nan, 0.0]), np.full(2, np.nan))
    with pytest.raises(StateError, match="has jumped"):
        rule.require(8 * MS, np.array([0.5, 0.0]), still)
