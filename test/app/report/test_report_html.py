"""The page: what stands in it, what it needs, and when it cannot be made."""

from __future__ import annotations

import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from made_up_run import MakeRun, Trial, trials, write_run

from tel_ros.app.report.data import read_run
from tel_ros.app.report.run import write_report
from tel_ros.core.errors import BagError, InputFileError
from tel_ros.core.trial import Outcome


class Page(HTMLParser):
    """A page taken apart: tags with their attributes, and the text outside of style sheets."""

    def __init__(self, file: Path) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str]]] = []
        self.words: list[str] = []
        self._in_style = False
        self.feed(file.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, {key: value or "" for key, value in attrs}))
        self._in_style = tag == "style"

    def handle_endtag(self, tag: str) -> None:
        self._in_style = False

    def handle_data(self, data: str) -> None:
        if not self._in_style:
            self.words.append(data)

    @property
    def text(self) -> str:
        return " ".join(" ".join(self.words).split())

    def count(self, tag: str) -> int:
        return sum(name == tag for name, _ in self.tags)


def test_the_report_asks_for_nothing_outside_itself(good_report: Path) -> None:
    assert not re.search(r"(https?|file|ftp)://|//\w|@import|url\((?!#)", good_report.read_text())
    page = Page(good_report)
    assert {"script", "link", "img", "iframe", "object", "base"}.isdisjoint(tag for tag, _ in page.tags)
    references = [value for _, attrs in page.tags for key, value in attrs.items() if key in ("src", "href")]
    assert references and all(reference.startswith("#") for reference in references)


def test_the_report_has_every_part_in_its_order(good_report: Path) -> None:
    page = Page(good_report)
    sections = [attrs["id"] for tag, attrs in page.tags if tag == "section"]
    assert sections == [
        "hand-path", "steps", "errors", "torques", "tracking", "trials", "theory", "growth", "configuration",
        "versions",
    ]  # fmt: skip
    assert page.count("svg") == 4 + 3
    for part in (
        "Practice run a-run",
        "test_arm (simulated arm) · path planar_loops · trajectory extension",
        "3 of 3 trials completed. RMS tracking error: 0.0500 rad (trial 1, 2.0 s) at first",
        "equilibrium point (EP)",
        "before learning",
        "subtree 1 under Gaussian 2",
        "a new root",
        "stiffness_nm_per_rad: [15.0, 15.0]",
        "numpy " + np.__version__,
    ):
        assert part in page.text, part


def test_one_picture_of_each_trial_is_shown_at_a_time_in_one_frame(good_report: Path) -> None:
    page, text = Page(good_report), good_report.read_text()
    inputs = [attrs for tag, attrs in page.tags if tag == "input"]
    labels = [attrs["for"] for tag, attrs in page.tags if tag == "label"]
    pictures = [attrs["id"] for tag, attrs in page.tags if attrs.get("id", "").startswith("picture-")]
    assert [each["id"] for each in inputs] == labels == ["trial-1", "trial-2", "trial-3"]
    assert ["checked" in each for each in inputs] == [True, False, False]
    assert pictures == ["picture-1", "picture-2", "picture-3"]
    for trial in (1, 2, 3):
        assert f"#trial-{trial}:checked ~ .pictures #picture-{trial} {{ display: block; }}" in text
    assert ".pictures > .drawing { display: none;" in text
    # In one frame: the axis below stands at the same place in all of them.
    ticks = [
        re.findall(r'-xtick_1">.*?<use [^>]*x="([\d.]+)" y="([\d.]+)"', part, flags=re.DOTALL)[0]
        for part in text.split('id="picture-')[1:]
    ]
    assert len(set(ticks)) == 1


def test_the_table_has_the_numbers_of_the_summary(good_report: Path) -> None:
    row = "2 0.600 1.67 0.0250 0.0250 0.0250 0.0500 0.0432 0.0032 – 8.00 1.00 0.0 1.2 completed"
    assert row in Page(good_report).text


def test_the_figures_are_there_as_png_files_too(good_report: Path) -> None:
    files = sorted((good_report.parent / "figures").iterdir())
    assert [file.name for file in files] == ["effort.png", "hand_path.png", "practice.png", "tracking.png"]
    assert all(file.read_bytes().startswith(b"\x89PNG\r\n") for file in files)


def test_no_two_elements_of_the_page_share_an_id_and_every_reference_is_met(good_report: Path) -> None:
    ids = [attrs["id"] for _, attrs in Page(good_report).tags if "id" in attrs]
    assert len(ids) == len(set(ids))
    assert set(re.findall(r'(?:href="#|url\(#)([^")]+)', good_report.read_text())) <= set(ids)


def test_the_figures_follow_the_colours_of_the_page(good_report: Path) -> None:
    text = good_report.read_text()
    drawings = re.findall(r"<svg.*?</svg>", text, flags=re.DOTALL)
    assert all("var(--" in drawing and not re.search(r"#[0-9a-f]{6}\b", drawing) for drawing in drawings)
    assert "@media screen and (prefers-color-scheme: dark)" in text


def test_a_run_that_was_aborted_says_so_first_and_marks_the_trials(bad_report: Path) -> None:
    page = Page(bad_report)
    assert (
        "The run was aborted: trial 4 was aborted: it did not settle. 2 of 4 trials completed." in page.text
    )
    assert "aborted the arm did not settle" in page.text
    assert [attrs.get("class") for tag, attrs in page.tags if tag == "tr"].count("broken") == 2
    assert "trial that was not completed" in page.text


def test_a_trial_without_a_movement_is_left_out_of_the_figures_and_said_to_be(bad_report: Path) -> None:
    page = Page(bad_report)
    drawn = read_run(bad_report.parent).drawn
    assert [(trial.summary.index, trial.recorded.report.index) for trial in drawn] == [(1, 1), (2, 2)]
    assert "Trial 4 is not drawn: it was aborted before the movement began." in page.text
    assert "4 1.000 1.00 – – – – – – – 8.00 1.00 – 1.2 aborted the arm did not settle" in page.text
    assert "nan" not in page.text.lower()


def test_a_missing_bag_is_named_and_does_not_keep_the_others_from_being_drawn(bad_report: Path) -> None:
    expected = "Trial 3 is not drawn: its bag cannot be used: trial_003: there is no such file or folder"
    assert expected in Page(bad_report).text


def test_a_run_of_which_no_bag_can_be_used_is_an_error_beside_the_page_of_its_summary(
    make_run: MakeRun,
) -> None:
    folder = make_run(trials(2))
    for bag in folder.glob("trial_*"):
        (bag / "metadata.yaml").unlink()
    with pytest.raises(BagError, match=r"none of its bags can be used \(Trial 1 is not drawn: .*Trial 2"):
        write_report(folder)
    assert "Nothing to draw" in Page(folder / "report.html").text


def test_a_movement_that_was_broken_off_is_drawn_and_marked(bad_report: Path) -> None:
    page = Page(bad_report)
    assert "Trial 2, aborted" in page.text
    assert "broken off" in page.text


def test_clipped_samples_are_marked(bad_report: Path, good_report: Path) -> None:
    assert "clipped at the limit" in Page(bad_report).text
    assert "clipped at the limit" not in Page(good_report).text


def test_a_band_is_drawn_explained_and_judged(sure_report: Path) -> None:
    page = Page(sure_report)
    assert "±2 standard deviations that the network expected of its command" in page.text
    explained = "so about 95 % of the error should lie within the band. Found within: 100 % in trial 2."
    assert explained in page.text


def test_without_a_band_none_is_mentioned(good_report: Path) -> None:
    page = Page(good_report)
    assert "Tracking error of each joint over the movement, for the same trials. figures/" in page.text
    assert not re.search("standard deviation|95.%|band", page.text)


def test_the_colours_of_a_band_follow_the_page(sure_report: Path) -> None:
    (style,) = set(re.findall(r'style="(fill: [^"]*); fill-opacity: 0\.2"', sure_report.read_text()))
    assert style == "fill: var(--blue)"


EVIL = "<script>alert('$x^$')</script>"


@pytest.fixture(scope="module")
def evil_report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The report of a run with a single trial, and with markup wherever somebody may write something."""
    aborted = Trial(outcome=Outcome.ABORTED, message=f"left {EVIL}")
    folder = tmp_path_factory.mktemp("evil") / "a-run"
    return write_report(write_run(folder, [aborted], outcome="aborted", message=f"1 {EVIL}", arm_name=EVIL))


def test_markup_in_names_and_messages_is_shown_and_not_executed(evil_report: Path) -> None:
    assert "<script" not in evil_report.read_text()
    # The line about the run, its outcome, the outcome of the trial, the configuration.
    assert Page(evil_report).text.count("<script>alert(") == 4


def test_each_of_several_paths_has_figures_and_a_row_of_its_own(make_run: MakeRun) -> None:
    names = ("planar_loops", "planar_loops_3")
    folder = make_run([Trial(index=k, path=names[(k - 1) % 2]) for k in (1, 2, 3)])
    page = Page(write_report(folder))
    sections = [attrs["id"] for tag, attrs in page.tags if tag == "section"]
    assert sections[0] == "movements"
    # Of the other there is one trial, which has nothing to step through.
    assert {"hand-path-1", "hand-path-2", "errors-1", "errors-2"} < set(sections)
    assert [each for each in sections if each.startswith("steps")] == ["steps-1"]
    assert (folder / "figures" / "tracking_2.png").is_file()
    assert "paths planar_loops, planar_loops_3 ·" in page.text
    assert "planar_loops_3: RMS tracking error: 0.0250 rad (trial 2" in page.text
    ids = [attrs["id"] for _, attrs in page.tags if "id" in attrs]
    assert len(ids) == len(set(ids))


def test_a_single_trial_has_nothing_to_step_through(evil_report: Path) -> None:
    page = Page(evil_report)
    assert "steps" not in [attrs.get("id") for _, attrs in page.tags]
    assert page.count("input") == 0


def test_a_run_without_any_movement_says_that_there_is_nothing_to_draw(make_run: MakeRun) -> None:
    folder = make_run([Trial(outcome=Outcome.CANCELLED, reached_run=False)], outcome="cancelled")
    (folder / "figures").mkdir()
    (folder / "figures" / "hand_path.png").write_bytes(b"of an earlier report")
    page = Page(write_report(folder))
    assert page.count("svg") == 1
    assert page.text.count("Nothing to draw") == 3
    assert "The movement did not begin in any trial" in page.text
    assert not (folder / "figures" / "hand_path.png").exists()


def test_writing_a_report_again_gives_the_same_report(make_run: MakeRun) -> None:
    folder = make_run([Trial(outcome=Outcome.ABORTED, reached_run=False)], outcome="aborted")
    once = write_report(folder).read_bytes()
    assert write_report(folder).read_bytes() == once
    assert not list(folder.rglob("*.tmp"))


def test_a_report_that_cannot_be_written_is_an_error_with_the_name_of_the_file(make_run: MakeRun) -> None:
    folder = make_run([Trial(outcome=Outcome.ABORTED, reached_run=False)])
    (folder / "figures").write_text("in the way")
    with pytest.raises(InputFileError, match="figures: is a file; expected a folder"):
        write_report(folder)


@pytest.mark.parametrize("library", ["matplotlib", "jinja2"])
def test_a_missing_library_is_named_with_what_to_install(make_run: MakeRun, library: str) -> None:
    without = f"import sys; sys.modules['{library}'] = None; from tel_ros.app.cli import main; main()"
    command = [sys.executable, "-c", without, "report", str(make_run(trials(1)))]
    made = subprocess.run(command, capture_output=True, text=True, timeout=50)
    assert (made.returncode, made.stdout) == (3, "")
    assert f"needs the Python module {library}, which comes with pip install 'tel_ros[report]'" in made.stderr


def test_the_loop_is_reported_trial_by_trial_where_it_was_measured(sure_report: Path) -> None:
    page = Page(sure_report)
    assert "timing" in {attrs.get("id") for tag, attrs in page.tags if tag == "section"}
    assert "2 497.2 500.0 0.012 1.234 9.876 0.456 0.789 17 the loop was not regular: 17 of 900" in page.text
