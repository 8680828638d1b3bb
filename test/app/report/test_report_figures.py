"""What the figures of a report draw."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest
from made_up_run import JOINTS, LINK_M, RATE_HZ, MakeRun, Trial, desired_rad, report_of
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_hex
from matplotlib.figure import Figure

from tel_ros.app.plotting import figure_style
from tel_ros.app.report.data import read_run
from tel_ros.app.report.figures import over_trials, path_panels, tracking_figure
from tel_ros.recording.summary import TrialRow
from tel_ros.recording.urdf import described

BAND = "±2 standard deviations that the network expected of its command"
N = Trial().n_points
INF = float("inf")


def test_the_curves_of_the_hand_are_the_forward_kinematics_of_the_recorded_run(make_run: MakeRun) -> None:
    run = read_run(make_run([Trial(duration_s=2.0)]))
    chain = described(run.config.arm).chain("hand")
    (panel,), sentence, labels = path_panels(run.drawn, chain)
    wanted = desired_rad(np.linspace(0.0, 1.0, 51))
    # Bags keep every bit, so only the rounding of two ways to calculate separates the two.
    np.testing.assert_allclose(panel.desired_m, two_links(wanted), atol=1e-12)
    np.testing.assert_allclose(panel.actual_m, two_links(wanted + 0.05), atol=1e-12)
    np.testing.assert_allclose(panel.equilibrium_m, two_links(wanted - 0.1), atol=1e-12)
    assert sentence == "The hand moves in the x–y plane of the base frame."
    assert labels == ["x [m]", "y [m]"]


def two_links(position_rad: np.ndarray) -> np.ndarray:
    first, both = position_rad[:, 0], position_rad.sum(axis=1)
    return LINK_M * np.column_stack([np.cos(first) + np.cos(both), np.sin(first) + np.sin(both)])


def tracking(make_run: MakeRun, *std_rad: tuple[float, ...]) -> Figure:
    """Return the figure of trials with these standard deviations."""
    made_of = [Trial(index=k + 1, std_rad=values) for k, values in enumerate(std_rad)]
    with figure_style("tracking"):
        return tracking_figure(read_run(make_run(made_of)).drawn, JOINTS)


def corners(axes: Axes) -> list[np.ndarray]:
    """Return the outlines of the bands in a panel, as rows of time and angle."""
    bands = [item for item in axes.collections if isinstance(item, PolyCollection)]
    return [path.vertices for band in bands for path in band.get_paths()]


def curves(axes: Axes) -> int:
    """Return the number of lines in a panel, without that at zero."""
    return sum(len(line.get_xdata()) > 2 for line in axes.lines)


def legend(figure: Figure) -> list[str]:
    return [text.get_text() for box in figure.legends for text in box.get_texts()]


def test_a_band_of_two_standard_deviations_lies_around_zero(make_run: MakeRun) -> None:
    std_rad = tuple(np.linspace(0.01, 0.03, N).tolist())
    figure = tracking(make_run, (), std_rad)
    for axes in figure.axes[1::2]:
        (outline,) = corners(axes)
        time = outline[:, 0]
        np.testing.assert_allclose(
            np.abs(outline[:, 1]), 2.0 * np.interp(time, np.linspace(0, 1, N), std_rad)
        )
        assert (time.min(), time.max()) == (0.0, 1.0)
        assert outline[:, 1].min() == -outline[:, 1].max()
    assert legend(figure).count(BAND) == 1


@pytest.mark.parametrize("unknown", [(), (INF,) * N], ids=["bag does not tell", "network knew nothing"])
def test_no_band_is_drawn_or_named_where_none_is_known(make_run: MakeRun, unknown: tuple[float, ...]) -> None:
    figure = tracking(make_run, unknown, unknown, unknown)
    assert [axes.get_title(loc="left") for axes in figure.axes] == list(JOINTS)
    assert all(not axes.collections for axes in figure.axes)
    assert legend(figure) == [f"Trial {k} (1.0\N{NO-BREAK SPACE}s)" for k in (1, 2, 3)]


def test_the_band_leaves_out_times_at_which_nothing_is_known(make_run: MakeRun) -> None:
    figure = tracking(make_run, (INF,) * 10 + (0.02,) * (N - 10))
    (outline,) = corners(figure.axes[0])
    assert outline[:, 0].min() == pytest.approx(10 / RATE_HZ)
    assert np.isfinite(outline).all()
    assert outline[:, 1].max() == pytest.approx(0.04)


def test_the_trials_with_a_band_are_drawn_beside_all_of_them_and_one_by_one(make_run: MakeRun) -> None:
    """The error of a trial before learning would leave nothing to see of the others."""
    figure = tracking(make_run, (INF,) * N, (0.02,) * N, (0.001,) * N)
    panels = [(axes.get_title(loc="left"), curves(axes), len(corners(axes))) for axes in figure.axes]
    assert panels == [
        ("shoulder: trials 1, 2 and 3", 3, 0), ("shoulder: trial 2", 1, 1), ("shoulder: trial 3", 1, 1),
        ("elbow: trials 1, 2 and 3", 3, 0), ("elbow: trial 2", 1, 1), ("elbow: trial 3", 1, 1),
    ]  # fmt: skip


def test_where_every_trial_has_a_band_each_is_drawn_once(make_run: MakeRun) -> None:
    figure = tracking(make_run, (0.02,) * N, (0.001,) * N)
    assert [axes.get_title(loc="left") for axes in figure.axes] == [
        f"{joint}: trial {k}" for joint in JOINTS for k in (1, 2)
    ]
    assert [curves(axes) for axes in figure.axes] == [1] * 4


@pytest.mark.parametrize("values", [(0.3, 0.1), (0.1, 0.3), (1e-4, 10.0)])
@pytest.mark.parametrize(("n", "log"), [(1, False), (4, True)])
def test_the_legend_of_the_trials_covers_no_marker(values: tuple[float, float], n: int, log: bool) -> None:
    rows = read_rows(*values)
    with figure_style("practice"):
        figure = Figure(figsize=(7.2, 2.75), layout="constrained")
        axes = figure.subplots(1, 3)[0]
        over_trials(axes, rows, [(values, f"what is drawn {k}", "#000000", "o") for k in range(n)], log=log)
        FigureCanvasAgg(figure).draw()
    box = axes.get_legend().get_window_extent().padded(2.0)
    for line in axes.lines:
        assert not any(box.contains(*point) for point in axes.transData.transform(line.get_xydata()))


def read_rows(*errors_rad: float) -> list[TrialRow]:
    made = [report_of(Trial(index=k), 0) for k in range(1, len(errors_rad) + 1)]
    return [
        TrialRow(**{field.name: getattr(report, field.name) for field in fields(report)}) for report in made
    ]


def test_a_band_has_the_colour_of_its_trial(make_run: MakeRun) -> None:
    figure = tracking(make_run, (0.02,) * N, (0.001,) * N)
    for axes in figure.axes:
        (band,), line = axes.collections, axes.lines[-1]
        assert to_hex(band.get_facecolor()[0]) == line.get_color()
        assert band.get_zorder() < line.get_zorder()
