"""The study of practice as fast as the arm can: what it counts, and that its page says so."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from tel_lab.studies.fastest import FIRST_SEED, GROUPS, Result, figure, group_row, summary, task
from tel_lab.tables import filled
from tel_lab.trial_record import TrialRecord
from tel_ros.core.config import SimConfig
from tel_ros.core.practice.strategy import Movement, PlannedTrial
from tel_ros.core.trial import Outcome, TrialReport

CONFIG, _ = task(GROUPS["kinematics"], FIRST_SEED, ())


def trial(index: int, duration_s: float, share: float | None, **other: object) -> TrialRecord:
    values: dict[str, object] = {
        "outcome": Outcome.COMPLETED,
        "saturated_ratio": 0.0,
        "rms_error_rad": 2e-3,
        **other,
    }
    excursion_rad = values.pop("excursion_rad", 0.01)
    none = np.zeros(2)
    report = TrialReport(
        index=index, alpha=1.0, duration_s=duration_s, message="", start_ns=0, run_ns=1, end_ns=2, ticks=1000,
        rms_error_per_joint_rad=none, max_error_rad=0.01, max_effort_nm=none, timing=None, **values,
    )  # fmt: skip
    return TrialRecord(
        PlannedTrial(index, 1.0, Movement(duration_s, effort_share=share)), report, excursion_rad
    )


def result(seed: int, *later: TrialRecord, group: str = "kinematics") -> Result:
    trials = (trial(1, 11.5, None, excursion_rad=0.2), *later)
    sim = SimConfig(coulomb_friction_nm=(0.1, 0.2), viscous_friction_nms_per_rad=(0.1, 0.1))
    return Result(group, seed, sim, 1.0, 1.05, "completed", "reached", trials, 0)


GOOD = [result(seed, trial(2, 3.0, 0.1), trial(3, 1.0 + 0.01 * seed, 0.9)) for seed in range(1, 11)]


def test_a_row_has_the_median_with_its_interval_and_counts_what_must_not_happen() -> None:
    row = group_row("kinematics", GOOD, CONFIG)
    assert row[1:4] == ["1.055 [1.020, 1.090]", "1.10: met", "2.00 [2.00, 2.00]"]
    assert row[4:10] == ["10 of 10", "3 [3, 3]", "0 of 10", "0 of 10", "0 of 10", "0 of 10"]
    bad = result(
        11,
        trial(2, 2.0, 0.5, outcome=Outcome.ABORTED, excursion_rad=0.3),
        trial(3, 1.4, 0.9, saturated_ratio=0.002, rms_error_rad=9e-3),
    )
    row = group_row("kinematics", [*GOOD, bad], CONFIG)
    assert row[4:10] == ["10 of 11", "3 [3, 3]", "0 of 11", "1 of 11", "1 of 11", "1 of 11"]
    assert bad.clipped == 2


def test_a_run_whose_last_trial_was_aborted_never_got_there() -> None:
    assert result(1, trial(2, 1.2, 0.9, outcome=Outcome.ABORTED)).time_over_bound == math.inf
    assert group_row("kinematics", [result(1, trial(2, 1.2, 0.9))] * 6, CONFIG)[2] == "1.10: not met"


def test_the_page_and_its_figure_have_every_group_and_the_slowest_runs_first() -> None:
    doubled = [replace(run, group="payload", n_before=2) for run in GOOD]
    text = filled("fastest-measured.md", command="tel study fastest", **summary([*GOOD, *doubled], CONFIG))
    assert "time / bound" in text and "Payload doubled near the limit" in text
    slowest = [
        line for line in text.splitlines() if line.strip().startswith("|") and "completed: reached" in line
    ]
    assert [line.split("|")[1].strip() for line in slowest] == ["10", "9", "8", "7", "6"]
    assert "| recovered: within the tolerance at the end" in text
    assert len(figure(GOOD, CONFIG).axes) == 3


@pytest.mark.parametrize("name", GROUPS)
def test_arms_and_paths_are_the_same_for_a_seed_and_others_for_another(name: str) -> None:
    (config, path), (again, same), (_, other) = (task(GROUPS[name], seed, ()) for seed in (7001, 7001, 7002))
    s = np.linspace(0.0, 1.0, 5)
    assert config == again
    np.testing.assert_array_equal(path.evaluate(s)[0], same.evaluate(s)[0])
    assert np.abs(path.evaluate(s)[0] - other.evaluate(s)[0]).max() > 0.01
