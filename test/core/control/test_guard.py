"""The guard takes over from a controller that falls silent, and only then."""

from __future__ import annotations

import numpy as np
import pytest
from two_link import Bench, TwoLinkArm, arm_config, make_bench, reach

from tel_ros.core.arm_state import ArmState
from tel_ros.core.config import ControlConfig, SafetyConfig
from tel_ros.core.control.guard import AwakeClock, CommandGuard
from tel_ros.core.trial import Phase

PERIOD_NS = 2_000_000


class GuardedArm:
    """An arm whose controller goes silent when told to; its guard sees all that was said."""

    def __init__(self, final_effort: str = "zero") -> None:
        safety = SafetyConfig(final_effort=final_effort)
        self.guard = CommandGuard(arm_config(), ControlConfig(), safety)
        self.bench: Bench = make_bench()
        self.bench.controller.start(reach())
        self.answers: list[np.ndarray | None] = []

    def state(self) -> ArmState:
        return ArmState(self.bench.time_ns, np.array(self.bench.arm.q), np.array(self.bench.arm.v))

    def controlled(self, duration_s: float) -> None:
        for _ in range(round(duration_s * 500)):
            state, now_s = self.state(), self.bench.time_ns / 1e9
            self.answers.append(self.guard.on_state(state, now_s))
            tick = self.bench.step()
            self.guard.on_command(tick.effort_nm, now_s)

    def silent(self, duration_s: float) -> np.ndarray:
        """Return the efforts of the guard; while it is silent, an arm without watchdog keeps the last one."""
        effort = self.bench.ticks[-1].effort_nm
        efforts = []
        for _ in range(round(duration_s * 500)):
            answer = self.guard.on_state(self.state(), self.bench.time_ns / 1e9)
            self.answers.append(answer)
            effort = effort if answer is None else answer
            self.bench.arm.step(effort, 0.002)
            self.bench.time_ns += PERIOD_NS
            efforts.append(effort)
        return np.array(efforts)

    def until_run(self) -> None:
        while self.bench.controller.time_from_start_s < 0.5:
            self.controlled(0.002)
        assert self.bench.controller.phase == Phase.RUN


def test_the_guard_is_silent_while_commands_come() -> None:
    arm = GuardedArm()
    arm.until_run()
    assert all(answer is None for answer in arm.answers)
    assert not arm.guard.active


def test_before_the_first_command_the_guard_commands_nothing() -> None:
    guard = CommandGuard(arm_config(), ControlConfig(), SafetyConfig())
    for k in range(100):
        assert guard.on_state(ArmState(k * PERIOD_NS, np.ones(2), np.ones(2)), 0.002 * k) is None


def test_a_controller_that_falls_silent_in_motion_is_replaced_after_the_time_out() -> None:
    arm = GuardedArm()
    arm.until_run()
    assert np.abs(arm.bench.arm.v).max() > 0.3
    n = len(arm.answers)
    arm.silent(3.0)
    silent = [answer is None for answer in arm.answers[n:]]
    assert silent.index(False) == pytest.approx(25, abs=1)  # 0.05 s
    assert not any(silent[26:])
    assert arm.bench.arm.kinetic_energy() < 1e-4
    np.testing.assert_array_equal(arm.answers[-1], 0.0)


def test_the_guard_holds_the_arm_if_it_is_configured_to() -> None:
    arm = GuardedArm("hold")
    arm.until_run()
    arm.silent(3.0)
    start_s = arm.bench.arm.time_s
    arm.bench.arm.push = lambda t: (0.15 * min(1.0, t - start_s), 0.0)
    arm.silent(2.0)
    np.testing.assert_allclose(arm.answers[-1], (-0.15, 0.0), atol=0.02)


def test_the_guard_yields_to_the_first_command() -> None:
    arm = GuardedArm()
    arm.until_run()
    arm.silent(0.2)
    assert arm.guard.active
    arm.guard.on_command(np.array([0.1, 0.0]), arm.bench.time_ns / 1e9)
    assert not arm.guard.active
    assert arm.guard.on_state(arm.state(), arm.bench.time_ns / 1e9 + 0.01) is None


def test_after_a_command_of_zero_effort_silence_is_in_order() -> None:
    arm = GuardedArm()
    arm.until_run()
    arm.guard.on_command(np.zeros(2), arm.bench.time_ns / 1e9)
    n = len(arm.answers)
    arm.silent(0.5)
    assert all(answer is None for answer in arm.answers[n:])


@pytest.mark.parametrize("bad", [[np.nan, 0.0], [np.inf, 0.0], [1.0], [1.0, 2.0, 3.0]])
def test_commands_that_cannot_be_used_do_not_keep_the_guard_silent(bad: list[float]) -> None:
    guard = CommandGuard(arm_config(), ControlConfig(), SafetyConfig())
    guard.on_command(np.array([1.0, 0.0]), 0.0)
    answers = []
    for k in range(40):
        guard.on_command(np.array(bad), 0.002 * k)
        answers.append(guard.on_state(ArmState(k * PERIOD_NS, np.zeros(2), np.ones(2)), 0.002 * k))
    assert answers[-1] is not None
    assert np.isfinite(answers[-1]).all()


def test_a_state_that_is_repeated_is_not_answered_twice() -> None:
    arm = GuardedArm()
    arm.until_run()
    arm.silent(0.2)
    now_s = arm.bench.time_ns / 1e9
    assert arm.guard.on_state(arm.state(), now_s) is not None
    assert arm.guard.on_state(arm.state(), now_s) is None


def test_the_guard_still_brakes_after_the_stamps_went_back() -> None:
    arm = GuardedArm()
    arm.until_run()
    arm.silent(0.1)
    arm.bench.time_ns -= 500_000_000
    answers = []
    for k in range(1500):
        answer = arm.guard.on_state(arm.state(), 1e3 + 0.002 * k)
        answers.append(answer)
        arm.bench.arm.step(answer, 0.002)
        arm.bench.time_ns += PERIOD_NS
    assert arm.bench.arm.kinetic_energy() < 1e-4
    np.testing.assert_array_equal(answers[-1], 0.0)


def test_the_guard_carries_the_weight_that_it_has_seen_carried() -> None:
    """A pull on the shoulder while it is held at rest, and the same pull after its controller has died."""
    guard = CommandGuard(arm_config(), ControlConfig(), SafetyConfig(final_effort="hold"))
    arm, time_ns = TwoLinkArm(push=lambda t: (-3.0, 0.0)), 0
    held = np.array([0.6 + 3.0 / 15.0, 1.3])
    for k in range(4000):
        q, v = np.array(arm.q), np.array(arm.v)
        state = ArmState(time_ns, q, v)
        answer = guard.on_state(state, 0.002 * k)
        if k < 2000:
            effort = 15.0 * (held - q) - 1.5 * v
            guard.on_command(effort, 0.002 * k)
            before = q
        elif answer is not None:
            effort = answer
        arm.step(effort, 0.002)
        time_ns += PERIOD_NS
    np.testing.assert_allclose(arm.q, before, atol=0.02)


@pytest.mark.parametrize("final_effort", ["zero", "hold"])
def test_the_guard_says_when_the_arm_has_its_final_effort(final_effort: str) -> None:
    arm = GuardedArm(final_effort)
    assert arm.guard.at_final_effort  # nobody has commanded anything
    arm.until_run()
    assert not arm.guard.at_final_effort
    arm.silent(0.1)
    assert arm.guard.active and not arm.guard.at_final_effort
    arm.silent(3.0)
    assert arm.guard.at_final_effort
    arm.guard.on_command(np.array([1.0, 0.0]), arm.bench.time_ns / 1e9)
    assert not arm.guard.at_final_effort
    arm.guard.on_command(np.zeros(2), arm.bench.time_ns / 1e9)
    assert arm.guard.at_final_effort


def test_it_agrees_with_the_clock_on_the_wall_while_somebody_looks_often() -> None:
    clock = AwakeClock(0.01, 100.0)
    for k in range(1, 501):
        clock.look(100.0 + 0.002 * k)
    assert clock.time_s == pytest.approx(1.0, rel=1e-9)


def test_a_stall_counts_as_one_step_only() -> None:
    clock = AwakeClock(0.01, 5.0)
    assert clock.look(7.0) == 0.01


def test_it_never_runs_backwards() -> None:
    clock = AwakeClock(0.01, 5.0)
    before = clock.look(5.005)
    assert clock.look(4.0) == before
    assert clock.look(4.001) == pytest.approx(before + 0.001)
