"""The judge of the fault campaign has to catch every violation that is made up for it."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
from fault_body import Body
from fault_judge import (
    Control,
    Episode,
    Trace,
    Verdict,
    caught_up_ns,
    crashes,
    judge,
    largest_work_from,
)

from tel_ros.core.trial import Phase

PERIOD_S = 0.004
N = 500
BODY = Body(
    stiffness_nm_per_rad=np.array([15.0]),
    torque_nm=lambda position_rad, acceleration_rad_s2: acceleration_rad_s2,
    soft_min_rad=np.array([-1.9]),
    soft_max_rad=np.array([1.9]),
    effort_limit_nm=np.array([20.0]),
    velocity_limit_rad_s=np.array([5.0]),
    position_min_rad=np.array([-2.0]),
    position_max_rad=np.array([2.0]),
)
"""A joint of 1 kg·m² without a weight."""
WEIGHTY = replace(BODY, torque_nm=lambda position_rad, acceleration_rad_s2: acceleration_rad_s2 + 3.0)
"""The same joint with a weight of 3 N·m: it may give back half of 2 g² / K = 1.2 J after a fall."""
STOP = Episode(
    expects="stop",
    trial=1,
    fault_ns=round(0.2e9),
    end_ns=round(N * PERIOD_S * 1e9),
    completed=False,
    work_tolerance_j=0.05,
    falls=False,
    calm_ns=round(0.2e9),
    body=BODY,
)


def traced(position_rad: np.ndarray, velocity_rad_s: object, effort_nm: object) -> Trace:
    """Return a trace of N samples of one joint; velocity and effort may be numbers."""
    stamps_ns = np.round(np.arange(len(position_rad)) * PERIOD_S * 1e9).astype(np.int64)
    columns = np.broadcast_arrays(position_rad, velocity_rad_s, effort_nm)
    return Trace(stamps_ns, *(np.array(column, dtype=float)[:, None] for column in columns))


def moved(effort_nm: np.ndarray, speed_rad_s: float = 1.0, drag: float = 0.0) -> Trace:
    """Return what a joint of 1 kg·m² does under given efforts. Shape of the efforts: (n,)."""
    position, velocity = np.zeros(len(effort_nm)), np.zeros(len(effort_nm))
    velocity[0] = speed_rad_s
    for k in range(1, len(effort_nm)):
        velocity[k] = velocity[k - 1] + PERIOD_S * (effort_nm[k] - drag * velocity[k - 1])
        position[k] = position[k - 1] + PERIOD_S * velocity[k]
    return traced(position, velocity, effort_nm)


def braked(delay_s: float, drive_nm: float = 1.0) -> Trace:
    """Return a joint that is driven, from a delay after the fault on braked, and then held without effort."""
    effort = np.full(N, drive_nm)
    velocity = 0.0
    brakes_at = round((0.2 + delay_s) / PERIOD_S)
    for k in range(1, N):
        if k > brakes_at:
            effort[k] = -min(18.0, velocity / PERIOD_S)
        velocity += PERIOD_S * effort[k]
    return moved(effort, speed_rad_s=0.0)


def judged(trace: Trace, **changes: object) -> Verdict:
    return judge(trace, replace(STOP, **changes))


@pytest.mark.parametrize("delay_s", [0.0, 0.05, 0.09])
def test_an_arm_that_is_braked_in_time_is_safe(delay_s: float) -> None:
    verdict = judged(braked(delay_s, drive_nm=4.0))
    assert verdict.violations == ()
    assert verdict.reaction_s == pytest.approx(delay_s, abs=0.03)  # the tolerance is a few periods' work


@pytest.mark.parametrize("delay_s", [0.15, 0.3, 1.0])
def test_an_arm_that_is_driven_on_is_not(delay_s: float) -> None:
    verdict = judged(braked(delay_s, drive_nm=4.0))
    assert any("drove the arm until" in text for text in verdict.violations)
    assert verdict.reaction_s == pytest.approx(delay_s, abs=0.03)


def test_an_arm_that_coasts_without_effort_is_safe() -> None:
    verdict = judged(moved(np.zeros(N), speed_rad_s=0.5))
    assert verdict.violations == ()
    assert (verdict.stopped, verdict.reaction_s) == ("zero", 0.0)


def test_a_kick_long_after_the_fault_is_found() -> None:
    effort = np.zeros(N)
    effort[400:420] = 15.0
    assert "drove the arm until" in judged(moved(effort, speed_rad_s=0.5)).violations[0]


def test_an_arm_that_swings_in_its_springs_without_end_is_not_held() -> None:
    effort, velocity, position = np.zeros(N), 1.0, 0.0
    for k in range(1, N):
        effort[k] = -15.0 * position
        velocity += PERIOD_S * effort[k]
        position += PERIOD_S * velocity
    assert "drove the arm until" in judged(moved(effort, speed_rad_s=1.0)).violations[0]


def test_an_arm_that_sinks_against_a_weak_brake_is_not_held() -> None:
    """Gravity does the work and the motors only brake, but the arm goes on and on."""
    verdict = judged(traced(0.5 * np.arange(N) * PERIOD_S, 0.25, -10.0), falls=True)
    assert [text for text in verdict.violations if "went on for" in text]


def test_a_joint_may_go_as_far_as_its_energy_drives_its_spring_and_no_further() -> None:
    n, first = np.arange(N), 80  # 0.32 s: 0.12 s after the fault
    out = np.clip((n - first) * PERIOD_S, 0.0, None)

    def caught(reach_rad: float) -> Verdict:
        position = reach_rad * np.minimum(out / 0.2, 1.0)
        return judged(traced(position, np.where(n <= first, 1.0, 0.0), np.where(n < first, 0.0, -1e-3)))

    explained_rad = np.sqrt(2.0 * (0.5 + 0.05) / 15.0)
    assert caught(0.98 * explained_rad).violations == ()
    assert "energy, weight and springs explain 0.27 rad" in caught(1.05 * explained_rad).violations[0]


def test_a_weight_may_sag_by_twice_what_it_deflects_its_spring() -> None:
    assert WEIGHTY.reach_rad(np.zeros(1), 0.0) == pytest.approx(2.0 * 3.0 / 15.0)
    assert WEIGHTY.kinetic_energy_j(np.zeros((1, 1)), np.array([[2.0]])) == pytest.approx(2.0)


def test_how_far_a_brake_gives_way_counts_from_when_it_has_its_states_again() -> None:
    time_s = np.arange(N) * PERIOD_S
    slides = np.minimum(0.5 * time_s, 0.6)  # until 1.2 s
    trace = traced(slides, np.where(time_s < 1.2, 0.25, 0.0), -0.1)
    assert judged(trace).violations
    assert judged(trace, calm_ns=round(1.2e9)).violations == ()


def test_an_arm_that_was_held_and_is_let_go_may_fall_into_the_soft_walls() -> None:
    time_s = np.arange(N) * PERIOD_S
    position = 2.0 * np.clip(time_s - 1.0, 0.0, 0.5) ** 2  # falls from 1 s to 1.5 s by half a radian
    effort = np.where(time_s < 1.0, -0.1, 0.0)
    effort[time_s > 1.5] = -0.1
    release = traced(position, 0.0, effort)
    assert judged(release, falls=True).violations == ()
    held_by_little = replace(release, effort_nm=np.full((N, 1), -0.1))
    assert any("went on for" in text for text in judged(held_by_little, falls=True).violations)


def test_springs_that_catch_a_falling_arm_may_give_back_some_of_its_energy() -> None:
    effort = np.zeros(N)
    effort[150:152], effort[160:164] = -120.0, 25.0  # from 1 rad/s almost to rest, and a little back
    trace = moved(effort, speed_rad_s=1.0)
    falling = replace(trace, velocity_rad_s=4.0 * trace.velocity_rad_s)
    assert any("drove the arm until" in text for text in judged(falling).violations)
    assert not any("drove the arm until" in text for text in judged(falling, falls=True).violations)


@pytest.mark.parametrize(("work_j", "is_driven"), [(0.5, False), (0.8, True)])
def test_springs_that_catch_what_fell_may_lift_its_weight_once_more(work_j: float, is_driven: bool) -> None:
    position, effort = np.zeros(N), np.zeros(N)
    effort[200:210] = 1e-9  # caught 0.6 s after the fault
    effort[210] = 10.0
    position[210:] = work_j / effort[210]
    lifted = traced(position, 0.0, effort)

    def drove(trace: Trace) -> bool:
        found = judged(trace, falls=True, body=WEIGHTY).violations
        return any("drove the arm until" in text for text in found)

    assert drove(lifted) == is_driven
    # An arm whose driver stands still says nothing meanwhile: that it was let go tells the time.
    held_before = effort.copy()
    held_before[:55] = 1e-9
    heard = np.r_[:55, 197:N]
    whole = traced(position, 0.0, held_before)
    gap = Trace(*(getattr(whole, field.name)[heard] for field in fields(Trace)[:-1]))
    assert drove(gap) == is_driven
    effort[:200] = 1e-9  # held all the time: it never fell
    assert drove(replace(lifted, effort_nm=effort[:, None]))


@pytest.mark.parametrize(
    ("caught_rad", "work_j", "is_driven"), [(2.0, 0.9, False), (2.0, 1.1, True), (1.9, 0.9, True)]
)
def test_soft_limits_may_lift_back_what_fell_beyond_them(
    caught_rad: float, work_j: float, is_driven: bool
) -> None:
    position, effort = np.full(N, caught_rad), np.zeros(N)
    effort[200:210] = 1e-9
    effort[210] = -10.0
    position[210:] -= work_j / 10.0
    found = judged(traced(position, 0.0, effort), falls=True, body=WEIGHTY).violations
    assert any("drove the arm until" in text for text in found) == is_driven


@pytest.mark.parametrize(("peak_rad_s", "is_violation"), [(6.5, False), (7.0, True)])
def test_a_falling_arm_may_be_as_fast_as_it_was_when_it_was_caught(
    peak_rad_s: float, is_violation: bool
) -> None:
    trace = moved(np.zeros(N), 0.0)
    trace.velocity_rad_s[200:300] = 6.0  # the limit is 5
    trace.effort_nm[240:300] = -1e-6
    trace.velocity_rad_s[250] = peak_rad_s
    found = judged(trace, falls=True).violations
    assert any("speed of" in text for text in found) == is_violation


def test_nothing_is_asked_before_the_fault_and_after_the_next_trial_has_begun() -> None:
    effort = np.zeros(N)
    effort[:40], effort[400:] = 4.0, 8.0
    trace = moved(effort, speed_rad_s=0.0)
    next_trial = Control(int(trace.time_ns[395]), 2, Phase.APPROACH)
    assert judge(trace, STOP).violations  # nobody said that a trial begins
    slow = replace(trace, controls=[next_trial], velocity_rad_s=np.zeros((N, 1)))
    assert judge(slow, replace(STOP, fault_ns=round(0.17e9))).violations == ()


def test_a_trial_that_begins_on_a_braked_arm_that_still_moves_is_found() -> None:
    effort = np.full(N, -0.01)
    trace = replace(moved(effort), controls=[Control(round(1.0e9), 2, Phase.APPROACH)])
    assert any("the next trial began at" in text for text in judged(trace).violations)


@pytest.mark.parametrize("expects", ["either", "end"])
def test_where_the_trial_may_go_on_the_arm_has_to_brake_only_from_stop_on(expects: str) -> None:
    driven = braked(0.5, drive_nm=4.0)
    assert judged(driven, expects=expects, completed=True).violations == ()
    in_time = replace(driven, controls=[Control(round(0.69e9), 1, Phase.STOP)])
    assert judged(in_time, expects=expects).violations == ()
    late = replace(driven, controls=[Control(round(0.45e9), 1, Phase.STOP)])
    assert "drove the arm until" in judged(late, expects=expects).violations[0]


@pytest.mark.parametrize("expects", ["either", "end"])
def test_where_a_controller_falls_silent_in_mid_trial_nothing_may_act_from_then_on(expects: str) -> None:
    effort = np.zeros(N)
    effort[:100] = 2.0
    ticks = [Control(round(k * PERIOD_S * 1e9), 1, Phase.RUN) for k in range(100)]
    quiet = replace(moved(effort, speed_rad_s=0.0), controls=ticks)
    assert judged(quiet, expects=expects).violations == ()
    effort[100:200] = 2.0
    driven = replace(moved(effort, speed_rad_s=0.0), controls=ticks)
    assert any("drove the arm until" in text for text in judged(driven, expects=expects).violations)


def test_a_trial_that_should_have_gone_on_and_was_aborted_is_found() -> None:
    assert judged(moved(np.zeros(N)), expects="ride", completed=True).violations == ()
    assert "was not completed" in judged(moved(np.zeros(N), 0.1), expects="ride").violations[0]


@pytest.mark.parametrize("expects", ["stop", "ride", "either", "end"])
@pytest.mark.parametrize(
    ("field", "value", "said"),
    [
        ("effort_nm", 20.1, "effort of 1.005"),
        ("effort_nm", -20.1, "effort of 1.005"),
        ("effort_nm", np.nan, "effort of nan"),
        ("velocity_rad_s", -5.5, "speed of 1.100"),
        ("velocity_rad_s", np.nan, "speed of nan"),
        ("position_rad", 2.01, "out of the range"),
        ("position_rad", -2.01, "out of the range"),
        ("position_rad", np.nan, "out of the range"),
    ],
)
def test_one_sample_beyond_a_limit_is_found(expects: str, field: str, value: float, said: str) -> None:
    trace = moved(np.zeros(N), 0.0)
    getattr(trace, field)[300] = value
    verdict = judged(trace, expects=expects, completed=True)
    assert any(said in text for text in verdict.violations)
    getattr(trace, field)[300] = 0.0
    getattr(trace, field)[10] = value  # before the fault
    assert judged(trace, expects=expects, completed=True).violations == ()


def test_gravity_may_make_an_arm_without_effort_fast_but_motors_may_not() -> None:
    trace = moved(np.zeros(N), 0.0)
    trace.velocity_rad_s[300] = 6.0
    assert judged(trace, falls=True).violations == ()
    trace.effort_nm[300] = 1e-6
    assert any("speed of 1.200" in text for text in judged(trace, falls=True).violations)


def test_an_arm_whose_time_has_stopped_is_safe() -> None:
    trace = moved(np.ones(40), 0.0)
    assert judged(trace, fault_ns=round(0.5e9)).violations == ()


def test_the_largest_work_counts_what_comes_back_after_braking() -> None:
    effort = np.array([0.0, 2.0, -2.0, -2.0, 3.0, 3.0])
    position = np.array([0.0, 1.0, 2.0, 3.0, 4.0, 5.0])
    work_j = largest_work_from(effort[:, None], position[:, None])
    assert work_j.tolist() == [6.0, 6.0, 6.0, 6.0, 3.0, 0.0]


@pytest.mark.parametrize(
    ("late_s", "calm_ns"), [((0.3, 0.2, 0.012, 0.009), 1_012_000_000), ((0.3,) * 4, 1_000_000_000)]
)
def test_a_simulation_that_stood_still_is_calm_once_its_states_are_as_punctual_as_before(
    late_s: tuple[float, ...], calm_ns: int
) -> None:
    stamps = np.array([0, 4, 8, 1_000, 1_004, 1_008, 1_012]) * 1_000_000
    arrived = 5000.0 + stamps / 1e9 + np.array([0.001, 0.001, 0.05, *np.array(late_s) + 0.001])
    assert caught_up_ns(stamps, arrived, n_before=3, since_ns=1_000_000_000) == calm_ns


@pytest.mark.parametrize(
    ("log", "said", "found"),
    [
        ("[INFO] ended", "tel: node ep_controller was killed by SIGKILL; it said last: …", []),
        ("Traceback (most recent call last):\n …\nOSError: No space left", "", ["OSError: No space left"]),
        ("Fatal Python error: Segmentation fault", "", ["Fatal Python error"]),
        (
            "",
            "tel: node trial_recorder ended with code 1; No space left",
            ["ended with code 1"],
        ),
        ("", "tel: node inverse_dynamics was killed by SIGSEGV; no joint state", ["killed by SIGSEGV"]),
    ],
)
def test_a_process_that_broke_down_by_itself_is_found_whatever_it_said_last(
    log: str, said: str, found: list[str]
) -> None:
    violations = crashes({"trial_recorder": log}, said, "ep_controller")
    assert len(violations) == len(found)
    assert all(text in violation for text, violation in zip(found, violations, strict=True))
