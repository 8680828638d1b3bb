"""The report that sets several runs side by side, and the command that makes reports."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner, Result
from made_up_run import Trial, trials, write_run

from tel_ros.app.cli import main
from tel_ros.app.plotting import figure_style
from tel_ros.app.report.data import read_run
from tel_ros.app.report.runs import MOST_RUNS, Runs, differences, errors_figure, last_trials_figure
from tel_ros.core.trial import Outcome


def report(*arguments: object) -> Result:
    return CliRunner().invoke(main, ["report", *map(str, arguments)])


@pytest.fixture(scope="module")
def two(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Two runs of an arm; the second one was broken off in its last trial."""
    folder = tmp_path_factory.mktemp("two")
    made_of = [*trials(2), Trial(3, outcome=Outcome.ABORTED, message="0.7 rad off")]
    return (
        write_run(folder / "slow", trials(3)),
        write_run(folder / "bold", made_of, outcome="aborted", message="trial 3 was aborted"),
    )


def test_several_runs_stand_side_by_side_on_one_page_with_their_figures(
    two: tuple[Path, Path], tmp_path: Path
) -> None:
    made = report(*two, "--out", tmp_path / "both", "--figures", "svg", "--json")
    assert made.exit_code == 0, made.output
    page = Path(json.loads(made.stdout)["report"]).read_text()
    for part in ("2 practice runs", "slow", "bold", "aborted", "50.00", "Trial 3, aborted"):
        assert part in page, part
    assert page.count("<svg") == 3
    files = sorted(file.name for file in (tmp_path / "both" / "figures").iterdir())
    assert files == ["errors.svg", "hand_path.svg", "tracking.svg"]


def test_each_run_has_a_curve_of_its_own_and_one_that_was_broken_off_is_marked(
    two: tuple[Path, Path],
) -> None:
    runs = tuple(read_run(folder) for folder in two)
    with figure_style("errors"):
        figure, movements = (
            draw(Runs(("slow", "bold"), runs)) for draw in (errors_figure, last_trials_figure)
        )
    for axes in figure.axes:
        curves = [line for line in axes.lines if len(line.get_xdata()) == 3]
        assert [line.get_ydata().tolist() for line in curves] == [
            [trial.rms_error_rad for trial in run.trials] for run in runs
        ]
        assert sum(line.get_marker() == "x" for line in axes.lines) == 1
    for axes in movements.axes:
        assert sum(line.get_marker() == "x" for line in axes.lines) == 1
    for drawn in (figure, movements):
        labels = [text.get_text() for box in drawn.legends for text in box.get_texts()]
        assert labels == ["slow", "bold", "broken off"]


def test_only_what_differs_between_the_configurations_is_listed(tmp_path: Path) -> None:
    runs = [
        read_run(write_run(tmp_path / "a", trials(1), arm_name="one")),
        read_run(write_run(tmp_path / "b", trials(2), arm_name="other")),
    ]
    assert differences(runs) == {"arm.name": ["one", "other"], "practice.trials": ["1", "2"]}
    assert differences([runs[0], runs[0]]) == {}


def test_movements_of_different_arms_are_not_drawn_into_one_figure(
    two: tuple[Path, Path], tmp_path: Path
) -> None:
    other = write_run(tmp_path / "other", trials(1))
    (other / "planar_arm.urdf").write_text((other / "planar_arm.urdf").read_text() + "<!-- another arm -->")
    made = report(two[0], other, "--out", tmp_path / "both")
    assert made.exit_code == 0, made.output
    page = (tmp_path / "both" / "report.html").read_text()
    assert "slow and other are runs of different arms (URDF)" in page
    assert page.count("<svg") == 1


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["{slow}", "{bold}"], "--out is not given; expected a folder"),
        (["{slow}", "--out", "x"], "--out is x; expected only with several runs"),
        (["{slow}", "{slow}/../slow", "--out", "x"], "is given twice; expected different runs"),
        (["{slow}", "{bold}", "--out", "{bold}"], "is the folder of a run"),
        (["{slow}", "nowhere", "--out", "x"], "nowhere"),
        (["{slow}", "--figures", "png,gif"], "'gif' in 'png,gif'; expected formats of png, svg, pdf"),
        ([str(k) for k in range(MOST_RUNS + 1)] + ["--out", "x"], f"at most {MOST_RUNS} runs"),
    ],
)
def test_what_cannot_be_reported_on_is_refused_and_named(
    two: tuple[Path, Path], arguments: list[str], complaint: str
) -> None:
    made = report(*(argument.format(slow=two[0], bold=two[1]) for argument in arguments))
    assert made.exit_code == 2
    assert complaint in made.output
    assert not Path("x").exists()


def test_figures_of_an_earlier_report_in_other_formats_do_not_stay(tmp_path: Path) -> None:
    without_movement = [Trial(outcome=Outcome.ABORTED, reached_run=False)]
    run = write_run(tmp_path / "a-run", without_movement, outcome="aborted")  # has one figure
    assert report(run, "--figures", "svg,pdf").exit_code == 0
    assert {file.suffix for file in (run / "figures").iterdir()} == {".svg", ".pdf"}
    once = (run / "figures" / "practice.pdf").read_bytes()
    assert once.startswith(b"%PDF")
    assert report(run, "--figures", "pdf").exit_code == 0
    assert (run / "figures" / "practice.pdf").read_bytes() == once
    assert {file.suffix for file in (run / "figures").iterdir()} == {".pdf"}
