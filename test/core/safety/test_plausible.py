"""States that no arm can be in."""

from __future__ import annotations

import numpy as np
import pytest

from tel_ros.core.errors import StateError
from tel_ros.core.safety.plausible import Plausibility

MS = 1_000_000


def plausibility() -> Plausibility:
    return Plausibility(("shoulder", "elbow"), np.array([2.0, np.inf]), 0.1)


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
