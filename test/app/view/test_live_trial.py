"""What is drawn and plotted of a trial, without a page and without ROS."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tel_ros.app.plane import viewpoint
from tel_ros.app.view.live_trial import (
    KEPT_PATHS,
    MEASURED_POINTS,
    PATH_POINTS,
    GridSeries,
    History,
    LiveTrial,
    magnitude,
    round_up,
)
from tel_ros.app.view.words import status_html, trials_html
from tel_ros.core.kinematics import ChainJoint, SerialChain
from tel_ros.core.trajectories.trajectory import DesiredTrajectory
from tel_ros.core.trial import Outcome, Phase, TrialGoal

SCRIPT = "<img src=x onerror=alert(1)>"


def chain() -> SerialChain:
    """One joint about z, with a hand 0.5 m out."""
    zero, z = np.zeros(3), np.array([0.0, 0.0, 1.0])
    return SerialChain((ChainJoint(zero, zero, z, 0), ChainJoint(np.array([0.5, 0.0, 0.0]), zero, z, None)))


def goal(index: int = 1, n: int = 1001, std_rad: float | None = None) -> tuple[TrialGoal, np.ndarray]:
    time_ns = np.linspace(0, 4_000_000_000, n).astype(np.int64)
    position = np.linspace(0.0, np.pi / 2, n)[:, None]
    speed = np.full((n, 1), 0.4)
    desired = DesiredTrajectory(time_ns, position, speed, np.zeros((n, 1)))
    std = np.zeros(0) if std_rad is None else np.full((n, 1), std_rad)
    return TrialGoal(index, 0.5, desired, position + 0.1), std


def trial(index: int = 1, std_rad: float | None = None) -> LiveTrial:
    return LiveTrial(*goal(index, std_rad=std_rad), chain(), (20.0,))


def sample(time_s: float, position: float = 0.0, *, index: int = 1, phase: Phase = Phase.RUN) -> Any:
    return SimpleNamespace(
        trial=index,
        phase=phase,
        time_from_start_s=time_s,
        position_rad=[position],
        velocity_rad_s=[0.3],
        desired_position_rad=[0.1],
        effort_nm=[-5.0],
    )


def test_a_series_keeps_the_largest_magnitude_of_what_falls_into_one_cell() -> None:
    series = GridSeries(2, end_s=1.0, n_cells=10)
    for values in ([0.1, -0.5], [-0.3, 0.2], [0.2, 0.1]):
        series.add(0.55, np.array(values))
    assert series.values[5].tolist() == [-0.3, -0.5]
    assert np.isnan(np.delete(series.values, 5, axis=0)).all()


@pytest.mark.parametrize("time_s", [-0.001, 1.01, 50.0, float("nan")])
def test_a_series_leaves_out_what_is_not_on_its_grid(time_s: float) -> None:
    series = GridSeries(1, end_s=1.0, n_cells=10)
    series.add(time_s, np.array([1.0]))
    assert np.isnan(series.values).all()


def test_the_range_of_a_plot_holds_its_values_and_ignores_what_is_not_there() -> None:
    assert magnitude(np.array([np.nan, -0.3, np.inf, 0.2])) == 0.3
    assert magnitude(np.full(3, np.nan)) == 0.0
    assert round_up(0.0) == 1.0
    for value, end in ((0.013, 0.025), (0.3, 0.5), (7.0, 10.0), (9.99, 10.0), (100.0, 100.0)):
        assert round_up(value) == pytest.approx(end)
        assert round_up(value) >= value


def test_error_speed_and_torque_are_plotted_over_the_time_of_the_movement() -> None:
    live = trial()
    live.see(sample(2.0, 0.25))
    cell = np.flatnonzero(np.isfinite(live.error_rad.values[:, 0]))
    assert live.error_rad.time_s[cell] == pytest.approx([2.0], abs=0.02)
    assert live.error_rad.values[cell, 0] == pytest.approx([0.15])
    assert live.speed_rad_s.values[cell, 0] == pytest.approx([0.3])
    assert live.effort_share.values[cell, 0] == pytest.approx([-0.25])  # of 20 N·m


def test_the_path_of_the_hand_is_that_of_the_measured_positions_in_the_movement() -> None:
    live = trial()
    live.see(sample(-0.5, 1.0, phase=Phase.APPROACH))
    live.see(sample(0.1, 0.7, index=2))
    live.see(sample(0.1, 0.0))
    live.see(sample(0.2, np.pi / 2))
    live.see(sample(0.2, np.pi / 2))
    live.see(sample(4.2, 0.3, phase=Phase.HOLD))
    assert live.hand_m == pytest.approx(np.array([[0.5, 0.0, 0.0], [0.0, 0.5, 0.0]]))


def test_the_measured_path_has_no_more_points_than_can_be_told_apart_however_often_it_is_looked_at() -> None:
    live = trial()
    assert live.hand_m.shape == (0, 3)
    for time_s in np.repeat(np.linspace(0.0, 4.0, 4001), 2):
        live.see(sample(time_s, time_s))
    assert 0.9 * MEASURED_POINTS <= len(live.hand_m) <= MEASURED_POINTS + 1
    assert live.hand_m[0] == pytest.approx([0.5, 0.0, 0.0])
    assert live.hand_m[-1] == pytest.approx([0.5 * np.cos(4.0), 0.5 * np.sin(4.0), 0.0], abs=0.01)


def test_the_measured_path_has_a_gap_where_nothing_was_heard() -> None:
    live = trial()
    for time_s in (0.0, 0.1, 2.0, 2.1):
        live.see(sample(time_s, 0.0))
    assert np.isnan(live.hand_m).all(axis=1).tolist() == [False, False, True, False, False]
    assert np.isfinite(live.hand_m[[0, 1, 3, 4]]).all()


def test_the_planned_paths_are_thinned_but_keep_their_ends() -> None:
    live = trial()
    assert len(live.desired_m) == len(live.equilibrium_m) == PATH_POINTS
    assert live.desired_m[[0, -1]] == pytest.approx(np.array([[0.5, 0, 0], [0, 0.5, 0]]), abs=1e-12)
    assert live.equilibrium_m[0] == pytest.approx([0.5 * np.cos(0.1), 0.5 * np.sin(0.1), 0.0])


def test_the_band_is_the_standard_deviation_of_the_goal_during_the_movement_alone() -> None:
    live = trial(std_rad=0.02)
    during = live.error_rad.time_s <= 4.0
    assert live.std_rad[during, 0] == pytest.approx(0.02)
    assert np.isnan(live.std_rad[~during]).all()
    assert live.is_std_known


@pytest.mark.parametrize("std_rad", [None, float("inf")])
def test_there_is_no_band_while_nothing_is_known(std_rad: float | None) -> None:
    live = trial(std_rad=std_rad)
    assert not live.is_std_known
    assert np.isnan(live.std_rad).all()


LIMIT_NM = (20.0, 10.0)


def ended(index: int, outcome: Outcome = Outcome.COMPLETED, reason: str = "") -> tuple[Any, str]:
    numbers = {"alpha": 0.5, "duration_s": 4.0, "rms_error_rad": 0.01234, "max_error_rad": 0.0567}
    efforts = {"joint_names": ["shoulder", "elbow"], "max_effort_nm": [5.0, 9.0]}
    return SimpleNamespace(index=index, outcome=outcome, **numbers, **efforts), reason


def moved(index: int) -> LiveTrial:
    live = trial(index)
    for k in range(3):
        live.see(sample(0.1 * k, 0.1 * k, index=index))
    return live


def test_the_table_has_a_row_a_trial_and_the_newest_first() -> None:
    history = History()
    history.end(*ended(1), None)
    history.end(*ended(2, Outcome.ABORTED, "it left the path tolerance"), None)
    table = trials_html(history.trials, LIMIT_NM)
    assert table.index("<td>2</td>") < table.index("<td>1</td>")
    assert "0.0123" in table
    assert "aborted" in table
    assert "90 % elbow" in table  # the joint that is nearest to its limit
    assert 'title="it left the path tolerance"' in table


def test_paths_of_the_last_trials_are_kept_and_a_new_run_begins_without_any() -> None:
    history = History()
    for index in range(1, KEPT_PATHS + 3):
        history.end(*ended(index), moved(index))
    assert [index for index, _ in history.paths] == list(range(3, KEPT_PATHS + 3))
    history.end(*ended(1), moved(1))
    assert [index for index, _ in history.paths] == [1]
    assert [result.index for result, _ in history.trials] == [1]


def test_a_trial_that_is_told_twice_has_one_row() -> None:
    history = History()
    for index in (1, 2, 2):
        history.end(*ended(index), moved(index))
    assert [result.index for result, _ in history.trials] == [1, 2]
    assert [index for index, _ in history.paths] == [1, 2]


def test_a_trial_of_which_another_was_seen_has_no_path() -> None:
    history = History()
    history.end(*ended(2), moved(1))
    assert not history.paths


def status(**changed: object) -> str:
    """Return the words about a graph and its feedback, with some of their values changed."""
    graph = {"arm_age_s": 0.1, "sample": sample(0.1), "stopped": False, "paused": False}
    said = {"trial": 3, "trials": 15, "stage": "moving", "reason": "", "alpha": 0.5, "duration_s": 9.0}
    values = {**graph, "answer": "", "alarm": False, **said, "max_error_rad": float("nan"), **changed}
    return status_html(SimpleNamespace(**values), SimpleNamespace(**values))


def test_what_comes_from_outside_is_text_on_the_page_and_nothing_else() -> None:
    history = History()
    history.end(*ended(1, reason=f'"{SCRIPT}'), None)
    for html in (trials_html(history.trials, LIMIT_NM), status(stage=SCRIPT, answer=SCRIPT)):
        assert "<img" not in html
        assert "&lt;img" in html
    assert 'title="&quot;&lt;img' in trials_html(history.trials, LIMIT_NM)


def test_a_number_of_trials_that_is_a_guess_is_said_to_be_one() -> None:
    assert "trial 3 of 15 " in status()
    assert "trial 3 of about 15 " in status(reason="the largest step that is allowed")


def test_the_words_tell_a_stop_a_pause_and_an_arm_that_is_silent() -> None:
    assert not any(word in status() for word in ("EMERGENCY", "pause", "no joint states"))
    assert "EMERGENCY STOP" in status(stopped=True)
    assert "pauses after this trial" in status(paused=True)
    assert ">paused<" in status(paused=True, stage="paused")
    assert "no joint states for 5 s" in status(arm_age_s=5.0)
    assert "no joint states yet" in status(arm_age_s=float("inf"))


@pytest.mark.parametrize(("missing", "towards"), [(2, (0, 0, 1)), (1, (0, -1, 0)), (0, (1, 0, 0))])
def test_a_path_in_a_plane_is_looked_at_from_before_it(missing: int, towards: tuple[int, ...]) -> None:
    path_m = np.insert(np.random.default_rng(0).uniform(0.2, 0.6, (20, 2)), missing, 0.0, axis=1)
    view = viewpoint(path_m)
    direction = view.position_m - view.target_m
    assert direction @ np.array(towards) > 0.9 * np.linalg.norm(direction)


def test_a_path_in_space_is_looked_at_from_above_and_from_outside() -> None:
    path_m = np.random.default_rng(0).uniform(-0.5, 0.5, (20, 3))
    view = viewpoint(path_m)
    assert view.position_m[2] > path_m[:, 2].max()
    assert np.linalg.norm(view.position_m - view.target_m) > view.size_m
