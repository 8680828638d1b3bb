"""The report of a practice run, from small runs written with the same writers as real ones."""

from __future__ import annotations

import builtins
import math
import re
import shutil
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import sim_bridge
from tel_ros.app.figures import path_panels
from tel_ros.app.hand_path import drawing_plane
from tel_ros.app.report import write_report
from tel_ros.app.report_data import RunData, read_run, spread
from tel_ros.app.report_text import ending, result, run_line, significant
from tel_ros.core.config import ArmConfig, Config, PathConfig, PracticeConfig
from tel_ros.core.control.records import Outcome, Phase, TrialReport
from tel_ros.core.errors import InputFileError, TelError
from tel_ros.core.types import NS_PER_S
from tel_ros.recording import topics
from tel_ros.recording.bag_writer import UNFINISHED, TrialBagWriter
from tel_ros.recording.message_types import typestore
from tel_ros.recording.run_folder import CONFIG_FILE, SUMMARY_FILE, create_run_folder, trial_bag
from tel_ros.recording.summary import RunSummary, TrialRow
from tel_ros.recording.urdf import chain_to_hand, read_urdf

URDF = Path(sim_bridge.__file__).parent / "urdf" / "planar_arm.urdf"
JOINTS = ("shoulder", "elbow")
LINK_M = 0.33  # both of them
RATE_HZ = 25.0
LIMIT_NM = 20.0


@dataclass(frozen=True)
class Trial:
    """What a trial of a made-up run is like."""

    index: int = 1
    duration_s: float = 1.0
    outcome: Outcome = Outcome.COMPLETED
    message: str = ""
    reached_run: bool = True
    saturated: bool = False
    grown: list[str] = field(default_factory=lambda: ["shoulder: subtree 1 under Gaussian 2", "a new root"])


def trials(n: int) -> list[Trial]:
    return [Trial(index=i + 1, duration_s=2.0 - i / max(1, n)) for i in range(n)]


def desired_rad(share: np.ndarray) -> np.ndarray:
    return np.column_stack([0.6 + 0.45 * np.sin(2 * np.pi * share), 1.3 + 0.3 * np.cos(2 * np.pi * share)])


def stamp(time_ns: int) -> Any:
    return typestore().types["builtin_interfaces/msg/Time"](
        sec=time_ns // NS_PER_S, nanosec=time_ns % NS_PER_S
    )


def write_bag(bag: Path, trial: Trial) -> TrialReport:
    """Write a bag with SETTLE, RUN and HOLD, the hand 0.05 rad off in RUN and far away outside of it."""
    types, serialise = typestore().types, typestore().serialize_cdr
    n_run = round(trial.duration_s * RATE_HZ) + 1 if trial.reached_run else 0
    phases = [Phase.SETTLE] * 3 + [Phase.RUN] * n_run + [Phase.HOLD] * 3
    period_ns = round(NS_PER_S / RATE_HZ)
    with TrialBagWriter(bag, {"trial": str(trial.index)}) as writer:
        for tick, phase in enumerate(phases):
            share = np.clip((tick - 3) / max(1, n_run - 1), 0.0, 1.0)
            wanted = desired_rad(np.array([share]))[0]
            actual = wanted + (0.05 if phase == Phase.RUN else 1.0)
            clipped = trial.saturated and tick == 10
            state = types["tel_interfaces/msg/ControlState"](
                header=types["std_msgs/msg/Header"](stamp=stamp(tick * period_ns), frame_id=""),
                trial=trial.index,
                phase=int(phase),
                time_from_start_s=(tick - 3) / RATE_HZ,
                desired_position_rad=wanted,
                desired_velocity_rad_s=np.zeros(2),
                desired_acceleration_rad_s2=np.zeros(2),
                equilibrium_rad=wanted - 0.1,
                position_rad=actual,
                velocity_rad_s=np.zeros(2),
                effort_nm=np.array([LIMIT_NM if clipped else 8.0 * math.sin(tick / 5.0), 1.0]),
                saturated=np.array([clipped, False]),
            )
            kind = topics.RECORDED_LIVE[topics.CONTROL_STATES]
            writer.write(topics.CONTROL_STATES, tick * period_ns, serialise(state, kind))
        report = report_of(trial, len(phases))
        kind = topics.RECORDED_ONCE[topics.TRIAL_RESULT]
        result = types[kind](
            index=trial.index,
            outcome=int(trial.outcome),
            message=trial.message,
            alpha=report.alpha,
            duration_s=trial.duration_s,
            start_stamp=stamp(0),
            run_stamp=stamp(report.run_ns),
            end_stamp=stamp(len(phases) * period_ns),
            ticks=len(phases),
            joint_names=list(JOINTS),
            rms_error_rad=report.rms_error_rad,
            rms_error_per_joint_rad=report.rms_error_per_joint_rad,
            max_error_rad=report.max_error_rad,
            max_effort_nm=report.max_effort_nm,
            saturated_ratio=report.saturated_ratio,
        )
        writer.write(topics.TRIAL_RESULT, len(phases) * period_ns, serialise(result, kind))
    return report


def report_of(trial: Trial, ticks: int) -> TrialReport:
    error_rad = 0.05 / trial.index if trial.reached_run else math.nan
    return TrialReport(
        index=trial.index,
        alpha=1.0 / trial.duration_s,
        duration_s=trial.duration_s,
        outcome=trial.outcome,
        message=trial.message,
        start_ns=0,
        run_ns=1 if trial.reached_run else 0,
        end_ns=ticks,
        ticks=ticks,
        rms_error_rad=error_rad,
        rms_error_per_joint_rad=np.full(2, error_rad),
        max_error_rad=2.0 * error_rad if trial.reached_run else 0.0,
        max_effort_nm=np.array([8.0, 1.0]),
        saturated_ratio=0.01 if trial.saturated else 0.0,
    )


def write_run(
    folder: Path,
    made_of: list[Trial],
    *,
    outcome: str = "completed",
    message: str = "",
    arm_name: str = "test_arm",
) -> Path:
    """Write the folder of a run that had these trials."""
    config = Config(
        arm=ArmConfig(
            name=arm_name,
            urdf=str(URDF),
            joints=JOINTS,
            hand_link="hand",
            stiffness_nm_per_rad=(15.0, 15.0),
            damping_nms_per_rad=(1.5, 1.5),
            effort_limit_nm=(LIMIT_NM, LIMIT_NM),
        ),
        path=PathConfig(name="planar_loops"),
        practice=PracticeConfig(trials=max(1, len(made_of))),
        seed=77,
    )
    summary = RunSummary(folder, create_run_folder(folder, config))
    for trial in made_of:
        bag = trial_bag(folder, trial.index)
        report = write_bag(bag, trial)
        learned = {"training_rms_before_rad": 0.04321, "training_rms_after_rad": 0.00321}
        row = TrialRow(report=report, bag=bag.name, wall_s=1.25)
        learns = trial.outcome == Outcome.COMPLETED
        summary.add(replace(row, grown=trial.grown, **learned) if learns else row)
    summary.end(outcome, message)
    return folder


MakeRun = Callable[..., Path]


@pytest.fixture
def make_run(tmp_path: Path) -> MakeRun:
    """Write a run folder: ``make_run(trials(3), outcome="aborted", message="why")``."""
    return lambda *args, **kwargs: write_run(tmp_path / "a-run", *args, **kwargs)


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


@pytest.fixture(scope="module")
def good_report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The report of three trials that went well. Tests only look at it: making it takes a second."""
    return write_report(write_run(tmp_path_factory.mktemp("good") / "a-run", trials(3)))


@pytest.fixture(scope="module")
def bad_report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The report of a run that went wrong in every way: clipped, broken off, no bag, no movement."""
    made_of = [
        Trial(1, saturated=True),
        Trial(2, outcome=Outcome.ABORTED, message="0.7 rad off"),
        Trial(3),
        Trial(4, outcome=Outcome.ABORTED, message="the arm did not settle", reached_run=False),
    ]
    message = "trial 4 was aborted: it did not settle"
    folder = tmp_path_factory.mktemp("bad") / "a-run"
    write_run(folder, made_of, outcome="aborted", message=message)
    shutil.rmtree(folder / "trial_003")
    return write_report(folder)


@pytest.fixture(scope="module")
def good_run(good_report: Path) -> RunData:
    """What the good report was made from."""
    return read_run(good_report.parent)


def drawn_indices(folder: Path) -> list[int]:
    drawn = read_run(folder).drawn
    assert all(trial.summary.index == trial.recorded.index for trial in drawn)
    return [trial.summary.index for trial in drawn]


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
        "hand-path", "errors", "torques", "tracking", "trials", "growth", "configuration", "versions",
    ]  # fmt: skip
    assert page.count("svg") == 4
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
    assert drawn_indices(bad_report.parent) == [1, 2]
    assert "Trial 4 is not drawn: it was aborted before the movement began." in page.text
    assert "4 1.000 1.00 – – – – – – – 8.00 1.00 – 1.2 aborted the arm did not settle" in page.text
    assert "nan" not in page.text.lower()


def test_a_missing_bag_is_named_and_does_not_keep_the_others_from_being_drawn(bad_report: Path) -> None:
    expected = "Trial 3 is not drawn: its bag cannot be used: trial_003: there is no such folder"
    assert expected in Page(bad_report).text


def test_a_movement_that_was_broken_off_is_drawn_and_marked(bad_report: Path) -> None:
    page = Page(bad_report)
    assert "Trial 2, aborted" in page.text
    assert "broken off" in page.text


def test_clipped_samples_are_marked(bad_report: Path, good_report: Path) -> None:
    assert "clipped at the limit" in Page(bad_report).text
    assert "clipped at the limit" not in Page(good_report).text


def test_markup_in_names_and_messages_is_shown_and_not_executed(make_run: MakeRun) -> None:
    evil = "<script>alert('$x^$')</script>"
    aborted = Trial(outcome=Outcome.ABORTED, message=f"left {evil}")
    folder = make_run([aborted], outcome="aborted", message=f"trial 1 {evil}", arm_name=evil)
    file = write_report(folder)
    assert "<script" not in file.read_text()
    # The line about the run, its outcome, the outcome of the trial, the configuration.
    assert Page(file).text.count("<script>alert(") == 4


def test_a_run_without_any_movement_says_that_there_is_nothing_to_draw(make_run: MakeRun) -> None:
    folder = make_run([Trial(outcome=Outcome.CANCELLED, reached_run=False)], outcome="cancelled")
    (folder / "figures").mkdir()
    (folder / "figures" / "hand_path.png").write_bytes(b"of an earlier report")
    page = Page(write_report(folder))
    assert page.count("svg") == 1
    assert page.text.count("Nothing to draw") == 3
    assert "In no trial did the movement begin" in page.text
    assert not (folder / "figures" / "hand_path.png").exists()


def test_writing_a_report_again_gives_the_same_report(make_run: MakeRun) -> None:
    folder = make_run([Trial(outcome=Outcome.ABORTED, reached_run=False)], outcome="aborted")
    once = write_report(folder).read_bytes()
    assert write_report(folder).read_bytes() == once
    assert not list(folder.rglob("*.tmp"))


@pytest.mark.parametrize(("n", "expected"), [(0, ""), (1, "a"), (2, "ab"), (3, "abc"), (5, "ace")])
def test_first_middle_and_last_are_chosen_each_once(n: int, expected: str) -> None:
    assert "".join(spread("abcde"[:n])) == expected


def test_the_curves_of_the_hand_are_the_forward_kinematics_of_the_recorded_run(make_run: MakeRun) -> None:
    run = read_run(make_run([Trial(duration_s=2.0)]))
    chain = chain_to_hand(read_urdf(Path(run.config.arm.urdf)), JOINTS, "hand")
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


def test_a_plane_of_the_base_frame_is_taken_as_it_is() -> None:
    t = np.linspace(0.0, 6.0, 50)
    plane = drawing_plane(np.column_stack([np.cos(t), 0.7 + 4e-4 * np.sin(t), np.sin(t)]))
    assert plane.names == ("x", "z")
    assert not plane.principal
    np.testing.assert_allclose(plane.project(np.array([[0.1, 0.7, 0.3]])), [[0.1, 0.3]])


def test_a_hand_that_leaves_every_plane_is_drawn_in_that_of_largest_extent() -> None:
    rng = np.random.default_rng(1)
    tilted = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    # A grid in the tilted plane, each place taken once above and once below: symmetric, so the fit is exact.
    along, across = np.meshgrid(np.linspace(-0.5, 0.5, 9), np.linspace(-0.3, 0.3, 7))
    flat = np.column_stack([along.ravel(), across.ravel()]) @ tilted[:2]
    places = np.vstack([flat + 0.004 * tilted[2], flat - 0.004 * tilted[2]]) + [0.2, 0.1, 0.4]
    plane = drawing_plane(places)
    assert plane.principal
    assert plane.out_of_plane_m == pytest.approx(0.004)
    assert "leaves it by up to 4 mm" in plane.description
    np.testing.assert_allclose(np.ptp(plane.project(places), axis=0), [1.0, 0.6])


def test_a_hand_in_a_tilted_plane_is_said_not_to_leave_it() -> None:
    t = np.linspace(0.0, 6.0, 50)
    plane = drawing_plane(np.column_stack([np.cos(t), np.sin(t), np.cos(t) + np.sin(t)]))
    assert plane.principal
    assert "does not leave" in plane.description


@pytest.mark.parametrize("index", [2, 3])  # one that a whole run would not have drawn, and one that it would
def test_a_bag_that_was_never_closed_is_named(make_run: MakeRun, index: int) -> None:
    folder = make_run(trials(4))
    (folder / f"trial_{index:03d}" / "metadata.yaml").unlink()
    (note,) = read_run(folder).notes
    assert note.startswith(f"Trial {index} is not drawn: its bag cannot be used: trial_{index:03d}: has no")


@pytest.mark.parametrize("index", [2, 3])
@pytest.mark.parametrize("share", [0.5, 0.98])
def test_a_truncated_bag_is_named(make_run: MakeRun, index: int, share: float) -> None:
    folder = make_run(trials(4))
    (file,) = (folder / f"trial_{index:03d}").glob("*.mcap")
    file.write_bytes(file.read_bytes()[: int(share * file.stat().st_size)])
    (note,) = read_run(folder).notes
    assert note.startswith(
        f"Trial {index} is not drawn: its bag cannot be used: trial_{index:03d}: cannot be"
    )


def test_a_bag_with_other_joints_is_named(make_run: MakeRun) -> None:
    folder = make_run(trials(1))
    file = folder / CONFIG_FILE
    file.write_text(file.read_text().replace("[shoulder, elbow]", "[elbow, shoulder]"))
    assert "trial_001: has the joints shoulder, elbow; expected elbow, shoulder" in read_run(folder).notes[0]


def test_a_recording_that_was_never_finished_is_mentioned(make_run: MakeRun) -> None:
    folder = make_run(trials(1))
    (folder / UNFINISHED / "trial_002").mkdir(parents=True)
    assert "The recording trial_002 was never finished" in read_run(folder).notes[0]


def test_the_lines_about_a_run_tell_what_it_was_and_what_came_out(good_run: RunData) -> None:
    assert run_line(good_run) == (
        "test_arm (simulated arm) · path planar_loops · trajectory extension, even steps in duration · "
        "lms_tree (lms) · actual trajectory training · seed 77"
    )
    assert result(good_run).replace("\N{NO-BREAK SPACE}", " ") == (
        "RMS tracking error: 0.0500 rad (trial 1, 2.0 s) at first, 0.0167 rad (trial 3, 1.33 s) at best, "
        "0.0167 rad (trial 3, 1.33 s) in the end. From 2.0 s to 1.33 s, the movement became 1.5 times as "
        "fast."
    )


def test_half_a_movement_is_neither_the_best_nor_the_fastest(good_run: RunData) -> None:
    whole, half, _ = good_run.trials
    run = replace(good_run, trials=(whole, replace(half, outcome="aborted")))
    text = result(run).replace("\N{NO-BREAK SPACE}", " ")
    assert "0.0500 rad (trial 1, 2.0 s) at best, 0.0250 rad (trial 2, 1.67 s, aborted) in the end." in text
    assert "times as fast" not in text


@pytest.mark.parametrize(
    ("outcome", "message", "expected"),
    [
        ("completed", "", "3 of 3 trials completed."),
        ("cancelled", "the run was cancelled", "The run was cancelled. 3 of 3"),
        ("failed", "ep_controller died.", "The run failed: ep_controller died. 3 of 3"),
        ("running", "", "The run did not come to its end"),
    ],
)
def test_how_a_run_ended_is_said_plainly(
    good_run: RunData, outcome: str, message: str, expected: str
) -> None:
    assert ending(replace(good_run, outcome=outcome, message=message)).startswith(expected)


@pytest.mark.parametrize(
    ("value", "expected"),
    [(0.0681005, "0.0681"), (0.05, "0.0500"), (11.5, "11.5"), (20.0, "20.0"), (123.4, "123"), (0.0, "0.00"),
     (0.09999, "0.100"), (math.nan, "–")],
)  # fmt: skip
def test_numbers_have_three_digits_that_say_something(value: float, expected: str) -> None:
    assert significant(value) == expected


def test_a_folder_that_is_no_run_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputFileError, match="there is no such file; expected the folder of a practice run"):
        write_report(tmp_path / "nowhere")


def test_a_run_without_trials_is_refused_with_its_own_message(make_run: MakeRun) -> None:
    folder = make_run([], outcome="failed", message="the arm is not there")
    with pytest.raises(InputFileError, match="holds no trial: the arm is not there; expected a run with"):
        write_report(folder)
    assert not (folder / "report.html").exists()


@pytest.mark.parametrize("content", ["[]", "{}", '{"trials": [{}]}', '{"trials": [1]}', "{"])
def test_a_summary_of_another_kind_is_refused(make_run: MakeRun, content: str) -> None:
    folder = make_run(trials(1))
    (folder / SUMMARY_FILE).write_text(content)
    with pytest.raises(InputFileError, match=r"summary\.json: not readable"):
        write_report(folder)


def test_a_report_that_cannot_be_written_is_an_error_with_the_name_of_the_file(make_run: MakeRun) -> None:
    folder = make_run([Trial(outcome=Outcome.ABORTED, reached_run=False)])
    (folder / "figures").write_text("in the way")
    with pytest.raises(InputFileError, match="figures: cannot be written"):
        write_report(folder)


def test_a_missing_configuration_is_refused(make_run: MakeRun) -> None:
    folder = make_run(trials(1))
    (folder / CONFIG_FILE).unlink()
    with pytest.raises(InputFileError, match=r"run\.yaml: there is no such file"):
        write_report(folder)


@pytest.mark.parametrize("library", ["matplotlib", "jinja2"])
def test_a_missing_library_is_named_with_what_to_install(
    make_run: MakeRun, monkeypatch: pytest.MonkeyPatch, library: str
) -> None:
    original = builtins.__import__

    def import_without(name: str, *args: Any, **kwargs: Any) -> Any:
        if name == library:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
        return original(name, *args, **kwargs)

    folder = make_run(trials(1))
    monkeypatch.setattr(builtins, "__import__", import_without)
    with pytest.raises(TelError, match=rf"needs {library}.*pip install 'tel_ros\[report\]'"):
        write_report(folder)
