"""Arms that are not as they say: frozen readings, wrong wiring, weak drives. The truth is at the drive."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from two_link import ARM, arm_config, reach

from tel_ros.core.arm_state import ArmState
from tel_ros.core.config import ControlConfig, SafetyConfig
from tel_ros.core.control.controller import EpController
from tel_ros.core.errors import TrajectoryError
from tel_ros.core.safety.gate import StateGate
from tel_ros.core.safety.layer import SafetyLayer
from tel_ros.core.safety.monitors import FirstMotion
from tel_ros.core.trial import Outcome, Tick, TrialGoal, TrialReport

sys.path.insert(0, str(Path(__file__).parents[2] / "contract"))

from faulty_arm import LIMITED_NM, FaultyArm  # noqa: E402

AWAY, START, END = (0.2, 0.5), (0.6, 1.0), (1.3, 0.2)
FROZEN = ("frozen", "frozen_elbow", "frozen_position", "frozen_velocity", "no_velocity_frozen")


class Rig:
    """A controller behind the gate on a faulty arm."""

    def __init__(self, fault: str = "", safety: dict | None = None, **arm: object) -> None:
        self.drive = FaultyArm(fault, **{"posture_rad": AWAY, **arm})
        config = arm_config(), ControlConfig(settle_time_s=0.2)
        self.controller = EpController(*config, SafetyConfig(**(safety or {})))
        self.gate = StateGate(*config)
        self.ticks: list[Tick] = []
        self.fastest_rad_s = 0.0
        """Of the true joints."""

    def step(self) -> None:
        reading = self.drive.step()
        self.fastest_rad_s = max(self.fastest_rad_s, *map(abs, self.drive.arm.v))
        stamp_ns = round(1e9 * (1.0 + reading.stamp_s))
        told = reading.position, reading.velocity, reading.effort
        tick = self.controller.tick(self.gate.admit(ARM["joints"], stamp_ns, *told, stamp_ns))
        if tick is not None:
            assert all(np.isfinite(values).all() for values in tick[2:7])
            self.ticks.append(tick)
            self.drive.command(tick.effort_nm.tolist())

    def run(self, goal: TrialGoal | None = None) -> TrialReport:
        self.controller.start(goal or reach(START, END, 2.0))
        return self.finish()

    def finish(self) -> TrialReport:
        end_s = self.drive.time_s + 40.0
        while self.controller.active:
            assert self.drive.time_s < end_s, self.controller.phase
            self.step()
        return self.controller.report

    def frozen_in_run(self, time_s: float) -> float:
        """Freeze the readings so long after the beginning of RUN; return when the trial has ended."""
        self.drive.from_s = np.inf
        self.controller.start(reach(START, END, 2.0))
        while self.controller.time_from_start_s < time_s:
            self.step()
        self.drive.from_s = self.drive.time_s
        self.finish()
        return self.drive.time_s - self.drive.from_s

    def require_let_go(self) -> None:
        """Nothing is commanded any more, and no other trial starts."""
        reason = self.controller.stopped_for
        n = len(self.ticks)
        for _ in range(250):
            self.step()
        assert len(self.ticks) == n + 250
        assert not any(tick.effort_nm.any() for tick in self.ticks[n - 1 :])
        assert self.controller.at_final_effort
        with pytest.raises(TrajectoryError, match="no trial starts before the stop is reset"):
            self.controller.start(reach(START, END, 2.0, index=2))
        assert reason and reason in self.controller.report.message


@pytest.mark.parametrize("time_s", [0.3, 0.6, 1.0, 1.5])
@pytest.mark.parametrize("fault", FROZEN)
def test_readings_that_freeze_in_mid_movement_end_it_without_effort_in_time(
    fault: str, time_s: float
) -> None:
    rig = Rig(fault)
    # Without velocities the position has to fall behind first.
    assert rig.frozen_in_run(time_s) <= (0.1 if fault == "no_velocity_frozen" else 0.08)
    report = rig.controller.report
    assert report.outcome == Outcome.ABORTED
    assert report.message.startswith("the readings of ")
    assert " are frozen: it" in report.message
    if fault == "frozen_elbow":
        assert "elbow" in report.message
    rig.require_let_go()
    assert rig.fastest_rad_s < 6.0, "15 rad/s, and the joint's stops, without this"


@pytest.mark.parametrize("fault", [*FROZEN, "zero_velocity"])
def test_readings_that_are_frozen_from_the_start_end_the_first_trial(fault: str) -> None:
    rig = Rig(fault)
    report = rig.run()
    assert report.outcome == Outcome.ABORTED
    assert "are frozen" in report.message
    assert ("or it sticks" in report.message) == ("effort has changed" in report.message)
    assert rig.drive.peak_nm.max() < 0.06 * ARM["effort_limit_nm"][0], "what a joint that sticks may need"
    rig.require_let_go()


@pytest.mark.parametrize(("bits", "duration_s"), [(10, 0.6), (12, 0.6), (40, 0.6), (10, 15.0), (40, 15.0)])
@pytest.mark.parametrize("fault", ["", "no_velocity_frozen"])
def test_encoders_at_rest_and_slow_ones_are_not_taken_for_frozen(
    bits: int, duration_s: float, fault: str
) -> None:
    rig = Rig(fault, encoder_rad=2.0 * np.pi / 2**bits, from_s=np.inf)
    assert rig.run(reach(START, END, duration_s)).outcome == Outcome.COMPLETED
    for _ in range(500):  # held at rest
        rig.step()
    assert rig.controller.stopped_for is None


@pytest.mark.parametrize(("position_rad", "is_frozen"), [(2.0, True), (2.85, False), (-2.9, False)])
def test_a_joint_that_leans_on_its_stop_is_not_frozen(position_rad: float, is_frozen: bool) -> None:
    layer = SafetyLayer(arm_config(), SafetyConfig(), 500.0)
    for k in range(200):
        where = ArmState(2_000_000 * (k + 1), np.array([position_rad, 0.0]), np.zeros(2))
        pull_nm = np.array([-0.05 * k * np.sign(position_rad), 0.0])
        layer.permit(where, pull_nm, pull_nm.item)
        if layer.readings.fault:
            break
    assert bool(layer.readings.fault) == is_frozen


@pytest.mark.parametrize(
    ("velocity", "is_frozen"),
    [
        (lambda k: 0.0, True),
        (lambda k: (-1.0) ** k * 2e-3, False),
        (lambda k: (-1.0) ** k * 2e-3 if k < 120 else 2e-3, True),
        (lambda k: 0.04 * 0.9**k, True),
    ],
    ids=["none", "noise", "noise that freezes as well", "what a filter makes of a position that is frozen"],
)
def test_a_joint_whose_velocity_tells_that_it_stands_may_stick_however_hard(
    velocity: Callable[[int], float], is_frozen: bool
) -> None:
    layer = SafetyLayer(arm_config(), SafetyConfig(), 500.0)
    for k in range(200):
        where = ArmState(2_000_000 * (k + 1), np.array([0.1, 0.0]), np.array([velocity(k), 0.0]))
        pull_nm = np.array([0.05 * k, 0.0])
        layer.permit(where, pull_nm, pull_nm.item)
        if layer.readings.fault:
            break
    assert ("the readings of shoulder are frozen" in layer.readings.fault) == is_frozen


def test_a_joint_that_learned_efforts_hold_still_while_others_pull_at_it_is_not_frozen() -> None:
    layer = SafetyLayer(arm_config(), SafetyConfig(), 500.0)
    for k in range(500):
        where = ArmState(2_000_000 * (k + 1), np.array([0.1, 0.0]), np.zeros(2))
        layer.permit(where, np.array([0.03 * k, 0.0]), [0.2, 0.0].__getitem__)
        assert not layer.readings.fault


def test_a_stop_for_frozen_readings_is_left_by_a_reset() -> None:
    rig = Rig("frozen")
    rig.frozen_in_run(1.0)
    rig.drive.from_s = np.inf
    rig.drive.arm.v = (0.0, 0.0)
    rig.controller.reset_stop()
    assert rig.run(reach(START, END, 2.0, index=2)).outcome == Outcome.COMPLETED


@pytest.mark.parametrize(
    ("fault", "fastest_rad_s", "says"),
    [
        ("swapped_commands", 2.5, "elbow moves away from where it is pulled"),
        ("swapped_states", 1.5, "shoulder moves away from where it is pulled"),
        ("flipped_effort", 2.0, "elbow moves away from where it is pulled"),
        ("flipped_position", 0.7, "shoulder moves away from where it is pulled"),
        (
            "degrees_velocity",
            2.0,
            "elbow moves at .* no brake is tried|effort of .* swings from side to side",
        ),
        ("effort_in_percent", 6.0, "the effort of elbow swings from side to side"),
    ],
)
def test_an_arm_that_is_wired_wrongly_is_let_go_of_in_its_first_approach(
    fault: str, fastest_rad_s: float, says: str
) -> None:
    rig = Rig(fault)
    report = rig.run()
    assert report.outcome == Outcome.ABORTED
    assert np.isnan(report.rms_error_rad), "it never came to the movement"
    assert re.search(says, report.message), report.message
    rig.require_let_go()
    assert rig.fastest_rad_s < fastest_rad_s


@pytest.mark.parametrize(("doubling_s", "is_driven"), [(0.12, True), (0.26, False)])
def test_only_as_fast_as_its_spring_could_drive_it_a_joint_counts_as_running_away(
    doubling_s: float, is_driven: bool
) -> None:
    monitor, posture = FirstMotion(arm_config()), np.array(START)
    monitor.begin(START)
    found = [
        monitor.look(
            ArmState(k * 2_000_000, posture + [0.0, 0.004 * 2.0 ** (0.002 * k / doubling_s)], np.zeros(2)),
            posture,
            np.zeros(2),
        )
        for k in range(500)
    ]
    assert any("elbow moves away" in words for words in found) == is_driven


@pytest.mark.parametrize(("step_rad", "found_by_rad"), [(1e-4, 0.021), (6e-4, 0.041), (1.5e-3, 0.042)])
def test_a_joint_that_runs_away_is_found_as_early_as_its_encoder_permits(
    step_rad: float, found_by_rad: float
) -> None:
    monitor, posture = FirstMotion(arm_config()), np.array(START)
    monitor.begin(START)
    for k in range(500):
        away = step_rad * round(1e-3 * 2.0 ** (0.002 * k / 0.12) / step_rad)
        if monitor.look(ArmState(k * 2_000_000, posture + [0.0, away], np.zeros(2)), posture, np.zeros(2)):
            break
    assert 0.019 < away < found_by_rad


@pytest.mark.parametrize(
    ("doublings_s", "is_driven"), [((0.12, 0.12), True), ((0.11, 0.125), False), ((0.8, 0.15), False)]
)
def test_a_joint_that_sags_at_an_uneven_pace_does_not_count_as_running_away(
    doublings_s: tuple[float, float], is_driven: bool
) -> None:
    monitor, posture = FirstMotion(arm_config()), np.array(START)
    monitor.begin(START)
    first_s, second_s = doublings_s
    paces_s = [0.0, 2.0 * first_s, 2.0 * first_s + 1.05 * second_s]
    times_s = np.arange(0.0, paces_s[-1], 0.002)
    # It doubles twice at the first pace, from half of what counts, and once at the second.
    away = 0.005 * 2.0 ** np.interp(times_s, paces_s, [0.0, 2.0, 3.05])
    found = [
        monitor.look(ArmState(round(1e9 * t), posture + [0.0, x], np.zeros(2)), posture, np.zeros(2))
        for t, x in zip(times_s, away, strict=True)
    ]
    assert any("elbow moves away" in words for words in found) == is_driven


def test_an_arm_outside_of_its_range_is_refused_before_anything_moves() -> None:
    rig = Rig("degrees")
    report = rig.run()
    assert report.outcome == Outcome.REFUSED
    assert "elbow is at 28.647 rad, outside of its range of -2.900 to 2.900 rad" in report.message
    assert not rig.ticks
    assert not rig.drive.peak_nm.any()


def test_an_arm_that_has_left_its_range_between_two_trials_stays_held_and_is_refused() -> None:
    rig = Rig()
    assert rig.run().outcome == Outcome.COMPLETED
    for elbow_rad, outcome in (
        (3.0, Outcome.REFUSED),
        (2.93, Outcome.COMPLETED),
    ):  # a little beyond is no fault
        rig.gate = StateGate(arm_config(), ControlConfig())
        rig.drive.arm.q, rig.drive.arm.v = (1.3, elbow_rad), (0.0, 0.0)
        report = rig.run(reach(END, START, 2.0, index=2))
        assert report.outcome == outcome, report.message


def test_a_drive_that_gives_less_than_commanded_is_said_and_its_ticks_count_as_clipped() -> None:
    rig, fast = Rig("limited_effort"), reach(START, END, 0.6)
    report = rig.run(fast)
    assert report.outcome == Outcome.COMPLETED
    assert re.search(r"^shoulder gives 1\.00 of \d\.\d\d N·m", report.message), report.message
    assert report.given_nm["shoulder"] == pytest.approx(LIMITED_NM)
    beyond = np.array([(np.abs(tick.effort_nm) > 2.0 * LIMITED_NM).any() for tick in rig.ticks])
    marked = np.array([tick.saturated.any() for tick in rig.ticks])
    assert beyond.sum() > 50
    assert np.mean(marked[beyond]) > 0.9
    assert not marked[~np.array([(np.abs(tick.effort_nm) > LIMITED_NM).any() for tick in rig.ticks])].any()
    assert report.saturated_ratio > 0.05
    again = Rig()
    assert again.run(fast).message == ""


@pytest.mark.parametrize("told", ["nothing", "noise", "negated", "percent", "late"])
def test_efforts_that_are_reported_otherwise_are_not_held_against_a_drive(told: str) -> None:
    rig, rng = Rig(), np.random.default_rng(5)
    step, past = rig.drive.step, []
    tell = {
        "nothing": lambda effort: [],
        "noise": lambda effort: rng.normal(0.0, 2.0, 2).tolist(),
        "negated": lambda effort: [-e for e in effort],
        "percent": lambda effort: [5.0 * e for e in effort],
        "late": lambda effort: past[-min(len(past), 11)],
    }[told]

    def stepped() -> object:
        reading = step()
        past.append(reading.effort)
        return replace(reading, effort=tell(reading.effort))

    rig.drive.step = stepped
    report = rig.run(reach(START, END, 0.6))
    assert (report.outcome, report.message, report.saturated_ratio) == (Outcome.COMPLETED, "", 0.0)
