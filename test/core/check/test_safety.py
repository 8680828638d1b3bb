"""What a check may do to an arm, whatever is wrong with the arm."""

from __future__ import annotations

import math
import re
from functools import cache

import numpy as np
import pytest
from synthetic_check import RoughArm, SyntheticCheck
from two_link import arm_config

from tel_ros.core.check.evidence import Heard
from tel_ros.core.check.pulses import (
    HALF_PULSE_S,
    STATE_GAP_S,
    Course,
    PulseBounds,
    PulseGuard,
    come_to_rest,
    doublet,
    fall_silent,
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


def heard(at_s: float, position_rad: np.ndarray = HERE, velocity_rad_s: float = 0.0) -> Heard:
    still = np.full(2, velocity_rad_s)
    return Heard(at_s, round(at_s * 1e9), 0.0, position_rad, still, np.zeros(2))


def guard(**bounds: float) -> PulseGuard:
    return PulseGuard(arm_config(), PulseBounds(**bounds), heard(0.0))


STRONGLY = ("", "flipped_effort", "effort_in_percent", "limited_effort", "frozen", "stale_stamps")


@pytest.mark.parametrize(
    ("fault", "share"), [*((fault, 0.02) for fault in FAULTS), *((fault, 0.1) for fault in STRONGLY)]
)
def test_no_command_exceeds_its_share_and_the_last_one_is_zero(fault: str, share: float) -> None:
    made = checked(fault, share)
    sent = np.abs(made.sent_nm)
    assert (sent.max() > 0.0) == (fault != "stale_stamps")
    assert sent.max() <= share * LIMIT_NM
    assert made.sent_nm[-1].tolist() == [0.0, 0.0]


@pytest.mark.parametrize("fault", FAULTS)
def test_no_joint_gets_out_of_the_allowed_range_and_all_come_to_rest(fault: str) -> None:
    made = checked(fault)
    assert np.abs(np.array(made.arm.arm.q) - HERE).max() < 0.06
    if made.guard.complaint is None and "frozen" not in fault:  # from the start, which nothing can show
        assert np.abs(made.arm.arm.v).max() < 0.02


@pytest.mark.parametrize("fault", FAULTS)
def test_only_the_strongest_pulses_last_longer_than_a_tenth_of_a_second(fault: str) -> None:
    made = checked(fault)
    for pulse in made.session.pulses:
        longest_s = 0.2 if abs(pulse.effort_nm) == made.guard.most_nm[pulse.joint] else HALF_PULSE_S
        assert pulse.zero_s - pulse.start_s <= 2.0 * longest_s + 1e-6


@pytest.mark.parametrize("way", [0.051, -0.051, math.nan])
def test_a_joint_that_leaves_the_range_ends_everything_with_zero_effort(way: float) -> None:
    watching = guard()
    pulse = Course(watching, doublet(watching, 0, 0.4, 0.005))
    assert pulse.step(heard(0.002)).tolist() == [0.4, 0.0]
    assert pulse.step(heard(0.004, HERE + [0.0, way])).tolist() == [0.0, 0.0]
    assert pulse.done
    assert "elbow" in watching.complaint
    later = Course(watching, come_to_rest(watching, np.ones(2), 1.0, np.ones(2)))
    assert later.step(heard(0.006)).tolist() == [0.0, 0.0]
    assert later.done


def test_without_states_zero_effort_is_commanded_at_once() -> None:
    watching = guard()
    pulse = Course(watching, doublet(watching, 0, 0.4, 0.005))
    pulse.step(heard(0.002))
    assert pulse.watch(0.05) is None
    assert pulse.watch(0.002 + STATE_GAP_S + 0.001).tolist() == [0.0, 0.0]
    assert pulse.done
    assert "no joint state" in watching.complaint


@pytest.mark.parametrize("breaks_at_s", [0.9, 1.13, 1.37])
@pytest.mark.parametrize(
    ("breaks", "reason"),
    [
        ("silent", "no joint state for 0.07 s"),
        ("repeats", "no new joint state for 0.07 s: their stamp repeats"),
        ("frozen", "the joint states are frozen, though their stamps go on: "),
    ],
)
def test_states_that_stop_repeat_or_freeze_end_it_by_name_within_a_tenth_of_a_second(
    breaks: str, reason: str, breaks_at_s: float
) -> None:
    made = SyntheticCheck(FaultyArm(), breaks=breaks, breaks_at_s=breaks_at_s)
    made.listen(0.2)
    made.pulse()
    assert made.guard.complaint.startswith(reason)
    assert made.sent_nm[-1].tolist() == [0.0, 0.0]
    # Where readings freeze while nothing is commanded, that shows only after the next change of the effort.
    acting_s = [
        t for t, sent in zip(made.sent_at_s, made.sent_nm, strict=True) if t > breaks_at_s and np.any(sent)
    ]
    assert not acting_s or acting_s[-1] - (acting_s[0] if breaks == "frozen" else breaks_at_s) < 0.1


@pytest.mark.parametrize("fault", ["frozen", "frozen_elbow"])
def test_positions_that_freeze_in_motion_while_efforts_go_on_end_it_at_once(fault: str) -> None:
    made = SyntheticCheck(FaultyArm(fault, from_s=2.2))  # in a pulse of the elbow
    made.listen(0.2)
    made.pulse()
    assert re.search(r"(shoulder|elbow) stands still, and is said to move at \S+ rad/s", made.guard.complaint)
    assert made.arm.time_s < 2.3


def test_frozen_readings_without_efforts_are_told_from_a_joint_that_cannot_move() -> None:
    def rough(fault: str) -> RoughArm:
        return RoughArm(fault, differences=True, coulomb_nm=0.02)

    frozen = SyntheticCheck(rough("no_effort_field"), breaks="frozen", breaks_at_s=2.8)
    dead = SyntheticCheck(rough("dead_channel"))
    for made in (frozen, dead):
        made.listen(0.2)
        made.pulse()
    assert "shoulder was pushed with" in frozen.guard.complaint
    assert frozen.arm.time_s < 3.6
    assert dead.guard.complaint is None


def test_readings_that_have_noise_and_lose_it_are_frozen_whether_or_not_anything_moves() -> None:
    made = SyntheticCheck(RoughArm(noise_rad=3e-4), breaks="frozen", breaks_at_s=0.55)
    made.listen(0.4)
    made.pulse()
    assert made.guard.complaint.endswith("their noise has gone")
    assert made.arm.time_s < 0.65


def test_a_velocity_that_stays_while_the_position_stands_still_ends_everything_at_once() -> None:
    for biased in (False, True):  # a constant that is there at rest as well is no motion
        watching = PulseGuard(arm_config(), PulseBounds(), heard(0.0, velocity_rad_s=0.3 * biased))
        pulse = Course(watching, doublet(watching, 0, 0.4, 0.005))
        for k in range(1, 50):
            pulse.step(heard(0.002 * k, velocity_rad_s=0.3))
        assert (watching.complaint is None) is biased
        assert biased or "shoulder stands still, and is said to move at 0.3 rad/s" in watching.complaint


def test_an_effort_beyond_the_share_is_clipped_and_one_that_is_not_finite_is_zero() -> None:
    watching = guard(effort_share=0.02)
    assert watching.allowed(np.array([5.0, -5.0])).tolist() == [0.4, -0.4]
    assert watching.allowed(np.array([math.nan, 0.1])).tolist() == [0.0, 0.0]
    assert watching.allowed(np.array([math.inf, 0.1])).tolist() == [0.0, 0.0]
    assert Course(watching, fall_silent(watching, 1, 9.0, [])).step(heard(0.002)).tolist() == [0.0, 0.4]


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
    rest = Course(watching, come_to_rest(watching, np.zeros(2), 0.0, np.full(2, 1e-4), timeout_s=1.0))
    for k in range(1, 600):
        now_s = 0.002 * k
        effort = rest.step(heard(now_s, HERE + 0.01 * math.sin(6.0 * now_s)))
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
def test_bounds_that_are_too_wide_are_refused_by_the_name_of_their_option(key: str, value: float) -> None:
    option = {"effort_share": "--effort-share", "range_rad": "--range"}[key]
    with pytest.raises(ConfigError, match=f"^{option} is .*; expected above 0 and up to"):
        PulseBounds(**{key: value})


def test_a_gap_that_is_too_long_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"state_gap_s is 0\.5; expected above 0 and up to 0\.1 s"):
        PulseGuard(arm_config(), PulseBounds(), heard(0.0), 0.5)
