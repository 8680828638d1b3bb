"""What a check may do to an arm, whatever is wrong with the arm."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest
from synthetic_check import SyntheticCheck
from two_link import arm_config

from tel_ros.core.check.pulses import (
    MOST_STATE_GAP_S,
    ComeToRest,
    Doublet,
    FallSilent,
    PulseBounds,
    PulseGuard,
)
from tel_ros.core.errors import ConfigError

from faulty_arm import FAULTS, LIMIT_NM, FaultyArm  # isort: skip

HERE = np.array([0.2, 0.5])


@cache
def checked(fault: str, share: float = 0.02) -> SyntheticCheck:
    """A whole session; the tests only look at what it has left behind."""
    made = SyntheticCheck(FaultyArm(fault), PulseBounds(effort_share=share))
    made.listen(0.2)
    made.pulse()
    return made


def guard(**bounds: float) -> PulseGuard:
    return PulseGuard(arm_config(), PulseBounds(**bounds), HERE, 0.0)


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("share", [0.02, 0.1])
def test_no_command_exceeds_its_share_and_the_last_one_is_zero(fault: str, share: float) -> None:
    made = checked(fault, share)
    sent = np.abs(made.sent_nm)
    assert sent.max() > 0.0
    assert sent.max() <= share * LIMIT_NM
    assert made.sent_nm[-1].tolist() == [0.0, 0.0]


@pytest.mark.parametrize("fault", FAULTS)
def test_no_joint_gets_out_of_the_allowed_range_and_all_come_to_rest(fault: str) -> None:
    made = checked(fault)
    assert np.abs(np.array(made.arm.arm.q) - HERE).max() < 0.06
    if made.guard.complaint is None:
        assert np.abs(made.arm.arm.v).max() < 0.02


@pytest.mark.parametrize("fault", FAULTS)
def test_no_effort_but_that_of_the_watchdogs_test_lasts_longer_than_a_tenth_of_a_second(fault: str) -> None:
    for pulse in checked(fault).session.pulses:
        assert pulse.zero_s - pulse.start_s <= 0.1 + 1e-6


@pytest.mark.parametrize("way", [0.051, -0.051, math.nan])
def test_a_joint_that_leaves_the_range_ends_everything_with_zero_effort(way: float) -> None:
    watching = guard()
    pulse = Doublet(watching, 0, 0.4, 0.005)
    assert pulse.step(0.002, HERE).tolist() == [0.4, 0.0]
    assert pulse.step(0.004, HERE + [0.0, way]).tolist() == [0.0, 0.0]
    assert pulse.done
    assert "elbow" in watching.complaint
    later = ComeToRest(watching, np.ones(2), 1.0, np.ones(2))
    assert later.step(0.006, HERE).tolist() == [0.0, 0.0]
    assert later.done


def test_without_states_zero_effort_is_commanded_at_once() -> None:
    watching = guard()
    pulse = Doublet(watching, 0, 0.4, 0.005)
    pulse.step(0.002, HERE)
    assert pulse.watch(0.05) is None
    assert pulse.watch(0.002 + MOST_STATE_GAP_S + 0.001).tolist() == [0.0, 0.0]
    assert pulse.done
    assert "no joint state" in watching.complaint


def test_states_that_are_lost_in_mid_session_end_it() -> None:
    made = SyntheticCheck(FaultyArm())
    made.listen(0.2)
    made.pulse(lost_after_s=0.5)
    assert "no joint state" in made.guard.complaint
    assert made.sent_nm[-1].tolist() == [0.0, 0.0]
    assert made.arm.time_s < 1.0


def test_an_effort_beyond_the_share_is_clipped_and_one_that_is_not_finite_is_zero() -> None:
    watching = guard(effort_share=0.02)
    assert watching.allowed(np.array([5.0, -5.0])).tolist() == [0.4, -0.4]
    assert watching.allowed(np.array([math.nan, 0.1])).tolist() == [0.0, 0.0]
    assert watching.allowed(np.array([math.inf, 0.1])).tolist() == [0.0, 0.0]
    assert FallSilent(watching, 1, 9.0).step(0.002, HERE).tolist() == [0.0, 0.4]


def test_the_first_pulse_is_a_sixteenth_of_the_strongest() -> None:
    made = checked("")
    first = next(effort for effort in made.sent_nm if np.any(effort))
    assert np.abs(first).max() == pytest.approx(0.02 * LIMIT_NM / 16)


def test_a_joint_that_moves_against_its_push_is_not_braked() -> None:
    """A damper with the wrong sign would drive it."""
    made = checked("flipped_effort")
    session = made.session
    elbow = next(p for p in session.pulses if p.joint == 1)
    sent = np.array(made.sent_nm)[:, 1]
    pulses = {0.0, *(round(s * abs(elbow.effort_nm) * k, 9) for s in (1, -1) for k in (1, 0.5, 0.25, 0.125))}
    silence = round(made.session.silence.effort_nm, 9) if made.session.silence.joint == 1 else 0.0
    assert {round(value, 9) for value in sent.tolist()} <= pulses | {silence, -silence}


def test_an_arm_that_does_not_rest_is_not_pulsed() -> None:
    watching = guard()
    rest = ComeToRest(watching, np.zeros(2), 0.0, np.full(2, 1e-4), timeout_s=1.0)
    for k in range(1, 600):
        now_s = 0.002 * k
        effort = rest.step(now_s, HERE + 0.01 * math.sin(6.0 * now_s))
        assert effort.tolist() == [0.0, 0.0]
    assert rest.done
    assert "does not come to rest without effort" in watching.complaint


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("effort_share", 0.11),
        ("effort_share", 0.0),
        ("effort_share", math.nan),
        ("range_rad", 0.3),
        ("range_rad", -0.1),
        ("range_rad", math.nan),
    ],
)
def test_bounds_that_are_too_wide_are_refused(key: str, value: float) -> None:
    with pytest.raises(ConfigError, match=f"{key} is .*; expected above 0 and up to"):
        PulseBounds(**{key: value})


def test_a_gap_that_is_too_long_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"state_gap_s is 0\.5; expected above 0 and up to 0\.1 s"):
        PulseGuard(arm_config(), PulseBounds(), HERE, 0.0, 0.5)
