"""The figure of a comparison shows what the table says, and its files are complete."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import pytest
from made_up_comparison import N_ARMS, made_up_comparison
from matplotlib.axes import Axes

from tel_lab.comparison.comparison_figure import comparison_figure
from tel_lab.comparison.comparison_table import write_files
from tel_lab.comparison.results import COLUMNS
from tel_ros.core.errors import InputFileError


@pytest.fixture(scope="module")
def panels() -> list[Axes]:
    return comparison_figure(made_up_comparison()).axes


def points(axes: Axes, marker: str) -> list[list[float]]:
    return [list(line.get_xdata()) for line in axes.get_lines() if line.get_marker() == marker]


def test_each_panel_has_a_dot_a_method_and_a_tick_an_arm(panels: list[Axes]) -> None:
    assert len(panels) == len(COLUMNS)
    medians, arms = points(panels[2], "o"), points(panels[2], "|")
    assert len(medians) == len(arms) == 5
    assert medians[1][0] == pytest.approx(1.055)
    assert len(arms[1]) == N_ARMS


def test_what_cannot_be_has_no_dot(panels: list[Axes]) -> None:
    assert len(points(panels[6], "o")) == 4
    assert "–" in [text.get_text() for text in panels[6].texts]


def test_never_lies_beyond_every_number_and_inside_the_panel(panels: list[Axes]) -> None:
    never = points(panels[0], "o")[0][0]
    reached = max(x[0] for x in points(panels[0], "o") if x[0] != never)
    assert reached < never <= panels[0].get_xlim()[1]
    assert "never" in [text.get_text() for text in panels[0].texts]


def test_rows_are_named(panels: list[Axes]) -> None:
    names = [label.get_text() for label in panels[0].get_yticklabels()]
    assert names[0] == "no learning"
    assert names[-1] == "exact inverse dynamics ³"


def test_files_are_complete_and_equal_for_equal_results(tmp_path: Path) -> None:
    for name in ("one", "other"):
        write_files(made_up_comparison(), tmp_path / name, "tel compare x.yaml")
    one = {path.name: path.read_bytes() for path in (tmp_path / "one").iterdir()}
    other = {path.name: path.read_bytes() for path in (tmp_path / "other").iterdir()}
    assert set(one) == {f"comparison.{suffix}" for suffix in ("csv", "json", "md", "svg", "png")}
    assert one == other
    assert ElementTree.fromstring(one["comparison.svg"]).tag.endswith("svg")


def test_a_folder_that_cannot_be_made_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputFileError, match="file"):
        write_files(made_up_comparison(), tmp_path / "file" / "out", "tel compare x.yaml")
