"""What studies say about a trial: how far the arm came off its path, and what a movement needs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tel_lab.exact_model import ExactInverseDynamics
from tel_lab.offline import OfflineArm
from tel_lab.trial_record import duration_at_effort_share, effort_share, excursion_rad
from tel_ros.core.trajectories.paths import NAMED_PATHS
from tel_ros.core.trajectories.trajectory import sample
from tel_ros.core.trial import Outcome, Phase, Trial, TrialGoal
from tel_ros.recording.config_file import load_config

ROOT = Path(__file__).parents[2]
CONFIG = load_config(ROOT / "config" / "planar_arm.yaml", ["control.path_tolerance_rad=0.15"])
PATH = NAMED_PATHS["planar_loops"]


@pytest.fixture(scope="module")
def aborted() -> Trial:
    """A trial without learning that leaves its narrow path tolerance."""
    desired = sample(PATH, 4.5, CONFIG.control.rate_hz)
    with OfflineArm(CONFIG) as arm:
        return arm.run_trial(TrialGoal(1, 1.0, desired, desired.position_rad))


def test_an_arm_that_runs_away_while_it_brakes_has_a_larger_excursion(aborted: Trial) -> None:
    assert aborted.report.outcome == Outcome.ABORTED
    last = np.flatnonzero(aborted.phase == Phase.RUN)[-1]
    position_rad = aborted.position_rad.copy()
    position_rad[last + 5, 1] = aborted.desired[last, 1] + 2.5
    assert aborted.phase[last + 5] == Phase.STOP
    assert excursion_rad(aborted) < 1.0
    assert excursion_rad(replace(aborted, position_rad=position_rad)) == pytest.approx(2.5)


def test_the_excursion_of_a_trial_that_only_ran_is_its_largest_error(aborted: Trial) -> None:
    run = aborted.phase == Phase.RUN
    only_run = replace(
        aborted,
        phase=aborted.phase[run],
        desired=aborted.desired[run],
        position_rad=aborted.position_rad[run],
    )
    assert excursion_rad(only_run) == pytest.approx(aborted.report.max_error_rad, abs=1e-12)  # rounding


def test_a_duration_found_for_an_effort_needs_that_effort() -> None:
    exact = ExactInverseDynamics(CONFIG, CONFIG.sim)
    duration_s = duration_at_effort_share(CONFIG.arm, exact, PATH, 0.5, 1.0)
    assert effort_share(CONFIG.arm, exact, PATH, duration_s) == pytest.approx(0.5, rel=1e-3)


def test_no_duration_below_the_fastest_is_given() -> None:
    exact = ExactInverseDynamics(CONFIG, CONFIG.sim)
    assert duration_at_effort_share(CONFIG.arm, exact, PATH, 0.5, 20.0) == 20.0
