"""What the figures of one bag draw."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from made_up_run import JOINTS, LIMIT_NM, MakeRun, Trial
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tel_ros.app.bag.figures import states_figure, trial_figure
from tel_ros.app.plotting import BLUE, GREEN, GREY, INK, ORANGE, PURPLE, figure_style
from tel_ros.core.trial import Outcome, Phase
from tel_ros.recording.joint_states import RecordedStates
from tel_ros.recording.trial_bag import RecordedTrial, read_trial


def drawn(trial: RecordedTrial, limits_nm: tuple[float, ...] | None = (LIMIT_NM, LIMIT_NM)) -> Figure:
    with figure_style("bag"):
        return trial_figure(trial, limits_nm, "a title")


def curve(axes: Axes, colour: str) -> np.ndarray:
    (line,) = (line for line in axes.lines if line.get_color() == colour and len(line.get_xdata()) > 2)
    return np.column_stack(line.get_data())


def words(figure: Figure) -> list[str]:
    return [text.get_text() for legend in figure.legends for text in legend.get_texts()]


def test_each_joint_shows_what_was_wanted_done_commanded_and_exerted(make_run: MakeRun) -> None:
    trial = read_trial(make_run([Trial()]) / "trial_001")
    panels = drawn(trial).axes
    assert [axes.get_title(loc="left") for axes in panels] == [joint for joint in JOINTS for _ in range(3)]
    for joint in range(2):
        position, error, torque = panels[3 * joint : 3 * joint + 3]
        desired_rad, actual_rad = trial.desired[:, joint], trial.position_rad[:, joint]
        for axes, colour, values in (
            (position, INK, desired_rad),
            (position, BLUE, actual_rad),
            (position, GREY, trial.equilibrium_rad[:, joint]),
            (error, ORANGE, actual_rad - desired_rad),
            (torque, GREEN, trial.effort_nm[:, joint]),
        ):
            np.testing.assert_array_equal(curve(axes, colour), np.column_stack([trial.time_s, values]))


def test_no_desired_position_is_drawn_while_the_arm_is_on_its_way_to_the_start(make_run: MakeRun) -> None:
    trial = read_trial(make_run([Trial()]) / "trial_001")
    phase = np.where(np.arange(len(trial.phase)) < 2, Phase.APPROACH, trial.phase)
    position, error, *_ = drawn(replace(trial, phase=phase)).axes
    for axes, colour in ((position, INK), (error, ORANGE)):
        np.testing.assert_array_equal(np.isnan(curve(axes, colour)[:, 1]), phase == Phase.APPROACH)
    assert np.isfinite(curve(position, BLUE)).all()


def test_limits_and_torques_that_were_held_back_are_marked_where_there_are_any(make_run: MakeRun) -> None:
    trial = read_trial(make_run([Trial(saturated=True)]) / "trial_001")
    figure = drawn(trial)
    shoulder = figure.axes[2]
    assert sorted(line.get_ydata()[0] for line in shoulder.lines if line.get_linestyle() == "--") == [-20, 20]
    assert [len(collection.get_paths()) for collection in shoulder.collections] == [1]
    assert {"limit", "torque held back"} <= set(words(figure))
    assert "limit" not in words(drawn(trial, None))


def test_a_trial_that_went_well_has_no_marks_of_trouble(make_run: MakeRun) -> None:
    figure = drawn(read_trial(make_run([Trial()]) / "trial_001"))
    assert not {"torque held back", "stopped"} & set(words(figure))
    assert "on the way to the start, or holding the end" in words(figure)


def test_the_stop_of_a_trial_is_shaded(make_run: MakeRun) -> None:
    trial = read_trial(make_run([Trial(outcome=Outcome.ABORTED, message="why")]) / "trial_001")
    phase = np.where(np.arange(len(trial.phase)) < 10, trial.phase, Phase.STOP)
    figure = drawn(replace(trial, phase=phase))
    assert "stopped" in words(figure)
    (shade,) = (patch for patch in figure.axes[0].patches if tuple(patch.get_facecolor()[:3]) == rgb(PURPLE))
    assert shade.get_x() == pytest.approx(trial.time_s[10])


def rgb(colour: str) -> tuple[float, ...]:
    return tuple(int(colour[k : k + 2], 16) / 255 for k in (1, 3, 5))


def test_joint_states_are_drawn_without_the_columns_that_nobody_told() -> None:
    nothing = np.full((3, 1), np.nan)
    values = np.array([[1.0], [2.0], [3.0]])
    time_s = np.array([0.0, 1.0, 2.0])
    figure = states_figure(RecordedStates("/s", ("a",), time_s, values, nothing, -values), "a title")
    assert [axes.get_ylabel() for axes in figure.axes] == ["position [rad]", "effort [N·m]"]
    np.testing.assert_array_equal(curve(figure.axes[1], GREEN), np.column_stack([time_s, -values]))
