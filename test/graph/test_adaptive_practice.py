"""Practice that decides for itself, on the real graph: the same decisions and trials as without ROS."""

from __future__ import annotations

import math

import numpy as np
from tel_process import COARSE, COARSEST, ROOT, StartTel, summary_of

from tel_lab.offline import OfflinePractice
from tel_lab.theory.run_theory import run_theory
from tel_ros.app.report.data import read_run
from tel_ros.core.practice.strategy import Ending
from tel_ros.core.trial import Outcome
from tel_ros.recording.config_file import load_config
from tel_ros.recording.network_file import load_network, new_network
from tel_ros.recording.resumption import earlier_trials
from tel_ros.recording.run_folder import json_ready, network_after
from tel_ros.recording.trial_bag import read_metadata, read_trial
from tel_ros.recording.waypoint_file import load_path

PLANAR, FASTEST = ROOT / "config" / "planar_arm.yaml", ROOT / "config" / "fastest.yaml"
MOVEMENTS = ROOT / "config" / "movements.yaml"
TOO_FAST_AT_ONCE = (
    "practice.strategy=adaptive_extension",
    *("practice.first_duration_s=9.0", "practice.goal_duration_s=3.0", "practice.step_tolerance_rad=0.9"),
    *("practice.trials=4", "control.path_tolerance_rad=0.285", *COARSEST),
    *("learning.weights=lms", "learning.rate=0.003", "learning.passes=1"),
)
"""Next to nothing is learned. So the second trial exceeds the path tolerance, and the run goes back to the
network of the first; four trials are not enough for the goal."""


def test_decisions_and_trials_are_those_of_the_same_run_without_ros(tel: StartTel) -> None:
    run = tel(*TOO_FAST_AT_ONCE, config=PLANAR)
    config = load_config(PLANAR, TOO_FAST_AT_ONCE)
    with OfflinePractice(config, load_path(config.path, config.arm), new_network(config)) as practice:
        offline = practice.run()
    code, out, err = run.finish()
    assert code == 1, err
    summary = summary_of(out)
    assert isinstance(practice.ending, Ending) and practice.ending.message in err
    assert (summary["outcome"], summary["message"]) == (practice.ending.outcome, practice.ending.message)
    rows = summary["trials"]
    assert [row["outcome"] for row in rows] == ["completed", "aborted", "completed", "completed"]
    assert rows[2]["went_back_to"] == 1
    assert "off its desired position (path tolerance 0.285 rad)" in rows[1]["message"]
    aborted = read_trial(run.folder / rows[1]["bag"])  # whole as well
    assert np.abs(aborted.velocity_rad_s[-1]).max() < 0.1  # and its end shows the arm at rest
    assert [row["reason"] for row in rows] == [practised.plan.reason for practised in offline]
    for key in ("alpha", "duration_s", "rms_error_rad", "max_error_rad", "ticks"):
        assert [row[key] for row in rows] == [getattr(done.trial.report, key) for done in offline], key
    # Decided from the same forecasts, to the last bit.
    expected_rad = [practised.plan.expected_rms_rad for practised in offline]
    assert [row["expected_rms_rad"] for row in rows] == json_ready(expected_rad)
    assert any(math.isfinite(value) for value in expected_rad)
    learned = [
        load_network(network_after(run.folder, done.plan.index)).trials_learned
        for done in offline
        if done.trial.report.outcome == Outcome.COMPLETED
    ]
    assert learned == list(range(1, len(learned) + 1))
    assert load_network(network_after(run.folder, 0)).trials_learned == 0
    theory = run_theory(read_run(run.folder))
    assert [trial.index for trial in theory.trials] == [1, 3, 4]
    assert theory.missing == ""
    assert all(0.0 < estimate.k_r < 1.0 for estimate in theory.estimates)


def test_the_fastest_movement_is_that_of_the_same_run_without_ros(tel: StartTel) -> None:
    quick = ("practice.first_duration_s=6.0", *COARSE)
    run = tel(*quick, config=FASTEST)
    config = load_config(FASTEST, quick)
    with OfflinePractice(config, load_path(config.path, config.arm), new_network(config)) as practice:
        offline = practice.run()
    code, out, err = run.finish()
    assert code == 0, err
    rows = summary_of(out)["trials"]
    assert practice.ending == Ending("completed", summary_of(out)["message"])
    planned = [[done.plan.reason, done.plan.movement.effort_share, done.plan.possible_s] for done in offline]
    assert [[row["reason"], row["effort_share"], row["possible_s"]] for row in rows] == json_ready(planned)
    for key in ("alpha", "duration_s", "rms_error_rad", "max_error_rad", "ticks"):
        assert [row[key] for row in rows] == [getattr(done.trial.report, key) for done in offline], key
    assert rows[-1]["effort_share"] == 0.9 and rows[-1]["duration_s"] < 1.7
    # From the bags and the networks in files the strategy decides the same once more.
    prepared = earlier_trials(run.folder, config)
    assert [row.effort_share for row in prepared.rows] == [row["effort_share"] for row in rows]


def test_several_paths_are_practised_by_turns_as_without_ros_and_can_be_gone_on_with(tel: StartTel) -> None:
    values = (
        "practice.goal_duration_s=4.0",
        "practice.first_duration_s=6.0",
        "practice.tolerance_rad=0.02",
        *COARSE,
    )
    run = tel(*values, config=MOVEMENTS)
    config = load_config(MOVEMENTS, values)
    with OfflinePractice(config, load_path(config.path, config.arm), new_network(config)) as practice:
        offline = practice.run()
    code, out, err = run.finish()
    assert code == 0, err
    rows = summary_of(out)["trials"]
    assert [row["path"] for row in rows] == [done.plan.movement.path for done in offline]
    assert {row["path"] for row in rows} == {"planar_loop", "planar_reach", "planar_swing"}
    assert [row["rms_error_rad"] for row in rows] == [done.report.rms_error_rad for done in offline]
    assert [read_metadata(run.folder / row["bag"])["path"] for row in rows] == [row["path"] for row in rows]
    earlier = earlier_trials(run.folder, load_config(run.folder / "run.yaml"))
    assert earlier.session.next() == practice.ending
