"""A motor that does nothing is noticed from what the arm reports; one that does something is left alone."""

from __future__ import annotations

import math

import numpy as np
import pytest
from two_link import arm_config

from tel_ros.core.arm_state import ArmState
from tel_ros.core.config import SafetyConfig
from tel_ros.core.safety.drives import DriveResponse
from tel_ros.core.safety.layer import SafetyLayer

PERIOD_NS = 2_000_000
LIMIT_NM = 20.0
PATIENT_TICKS = round(DriveResponse.PATIENCE_S * 1e9 / PERIOD_NS)


class Drive:
    """What a joint is commanded and reports, tick by tick."""

    def __init__(self, response: DriveResponse) -> None:
        self.response, self.ticks = response, 0

    def run(self, ticks: int, commanded: float, reported: float | None) -> str:
        for _ in range(ticks):
            self.ticks += 1
            heard = None if reported is None else np.array([0.0, reported])
            self.response.look(self.ticks * PERIOD_NS, np.array([0.0, commanded]), heard)
        return self.response.fault


@pytest.fixture
def drive() -> Drive:
    """Return one of a joint that has answered often enough to be judged."""
    drive = Drive(DriveResponse(("shoulder", "elbow"), (LIMIT_NM, LIMIT_NM)))
    assert drive.run(DriveResponse.ANSWERS_TO_BE_KNOWN, 5.0, 5.0) == ""
    return drive


@pytest.mark.parametrize("reported", [0.0, 2.4, -5.0], ids=["nothing", "less than half", "the other way"])
def test_a_motor_that_stops_answering_is_named_within_the_patience(drive: Drive, reported: float) -> None:
    assert drive.run(PATIENT_TICKS, 5.0, reported) == ""
    fault = drive.run(2, 5.0, reported)
    assert "elbow" in fault
    assert f"reports {reported:.2f} of 5.00 N·m" in fault


@pytest.mark.parametrize(
    ("commanded", "reported"),
    [(5.0, 2.6), (5.0, 50.0), (-5.0, -5.0), (1.9, 0.0), (5.0, math.nan), (5.0, None)],
    ids=["clipped by the drive", "more", "backward", "weak command", "NaN", "not reported"],
)
def test_what_is_no_silence_is_left_alone(drive: Drive, commanded: float, reported: float | None) -> None:
    assert drive.run(20 * PATIENT_TICKS, commanded, reported) == ""


def test_a_joint_that_never_reported_an_effort_is_not_judged() -> None:
    drive = Drive(DriveResponse(("shoulder", "elbow"), (LIMIT_NM, LIMIT_NM)))
    assert drive.run(DriveResponse.ANSWERS_TO_BE_KNOWN - 1, 5.0, 5.0) == ""  # may be chance
    assert drive.run(1000, 5.0, 0.0) == ""


def test_answers_that_come_late_are_answers(drive: Drive) -> None:
    for _ in range(20):
        assert drive.run(PATIENT_TICKS // 2, 5.0, -5.0) == ""
        assert drive.run(PATIENT_TICKS // 2, 5.0, 5.0) == ""


def test_a_driver_that_lets_go_in_the_gaps_of_lost_states_is_not_dead(drive: Drive) -> None:
    for _ in range(20):  # every third state that comes was measured while the driver acted
        for reported in (0.0, 0.0, 5.0):
            drive.ticks += PATIENT_TICKS  # states in between are lost
            assert drive.run(1, 5.0, reported) == ""


def test_an_answer_is_overdue_long_before_a_motor_counts_as_dead(drive: Drive) -> None:
    def is_overdue_after(ticks: int, commanded: float, reported: float | None) -> bool:
        assert drive.run(ticks, commanded, reported) == ""
        return drive.response.is_overdue(drive.ticks * PERIOD_NS)

    overdue_ticks = round(DriveResponse.OVERDUE_S * 1e9 / PERIOD_NS)
    assert not is_overdue_after(overdue_ticks, 5.0, 0.0)
    assert is_overdue_after(2, 5.0, 0.0)
    assert not is_overdue_after(1, 5.0, 5.0), "it has answered"
    assert is_overdue_after(overdue_ticks + 2, 5.0, 0.0)
    assert not is_overdue_after(1, 5.0, None), "nothing is reported any more: nobody knows"


def test_a_dead_motor_lives_again_once_it_answers_even_weakly(drive: Drive) -> None:
    assert drive.run(PATIENT_TICKS + 2, 5.0, 0.0)
    assert drive.run(100, 0.3, 0.0), "too weak to tell"
    assert drive.run(100, 0.5, 0.0)
    assert drive.run(1, 0.5, 0.5) == ""


def test_a_dead_motor_is_given_another_chance_and_found_dead_again(drive: Drive) -> None:
    assert drive.run(PATIENT_TICKS + 2, 5.0, 0.0)
    drive.response.forgive()
    assert drive.run(PATIENT_TICKS, 5.0, 0.0) == ""
    assert "elbow" in drive.run(2, 5.0, 0.0)


def test_nothing_is_said_where_reports_are_not_to_be_trusted() -> None:
    for arm, safety in (
        (arm_config(), SafetyConfig(watch_drives=False)),
        (arm_config(command_interface="position"), SafetyConfig()),
    ):
        drive = Drive(DriveResponse.of(arm, safety))
        drive.run(DriveResponse.ANSWERS_TO_BE_KNOWN, 5.0, 5.0)
        assert drive.run(100, 5.0, 0.0) == ""


def test_efforts_grow_from_zero_as_long_as_a_motor_does_not_act() -> None:
    safe, wanted = SafetyLayer(arm_config(), SafetyConfig(), 500.0), np.array([0.0, 18.0])
    zero = np.zeros(2)

    def permit(k: int, reported: float) -> float:
        state = ArmState(k * PERIOD_NS, zero + 1e-9 * k, zero, effort_nm=np.array([0.0, reported]))
        return float(safe.permit(state, wanted).effort_nm[1])

    last = 0.0
    for k in range(100):
        last = permit(k, last)
    assert last == 18.0
    for k in range(100, 100 + PATIENT_TICKS + 2):
        last = permit(k, 0.0)
    assert safe.response.fault
    assert [permit(k, 0.0) for k in range(200, 220)] == [4.0] * 20, "one step of the effort rate"
