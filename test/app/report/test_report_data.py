"""What is read for a report, what is noted as missing, and what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from made_up_run import MakeRun, Trial, trials

from tel_ros.app.report.data import read_run, spread
from tel_ros.app.report.run import write_report
from tel_ros.core.errors import InputFileError
from tel_ros.recording.bag_writer import UNFINISHED
from tel_ros.recording.run_folder import CONFIG_FILE, SUMMARY_FILE


@pytest.mark.parametrize(("n", "expected"), [(0, ""), (1, "a"), (2, "ab"), (3, "abc"), (5, "ace")])
def test_first_middle_and_last_are_chosen_each_once(n: int, expected: str) -> None:
    assert "".join(spread("abcde"[:n])) == expected


@pytest.mark.parametrize("index", [2, 3])  # one that a whole run would not have drawn, and one that it would
def test_a_bag_that_was_never_closed_is_named(make_run: MakeRun, index: int) -> None:
    folder = make_run(trials(4))
    (folder / f"trial_{index:03d}" / "metadata.yaml").unlink()
    (note,) = read_run(folder).notes
    assert note.startswith(f"Trial {index} is not drawn: its bag cannot be used: trial_{index:03d}: has no")


@pytest.mark.parametrize(("index", "share"), [(2, 0.5), (3, 0.98)])
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


def test_a_missing_configuration_is_refused(make_run: MakeRun) -> None:
    folder = make_run(trials(1))
    (folder / CONFIG_FILE).unlink()
    with pytest.raises(InputFileError, match=r"run\.yaml: there is no such file"):
        write_report(folder)


def test_the_error_is_that_of_the_movement_alone(make_run: MakeRun) -> None:
    (trial,) = read_run(make_run([Trial()])).drawn
    # The difference of two angles that were rounded apart from each other.
    np.testing.assert_allclose(trial.error_rad, np.full((26, 2), 0.05), atol=1e-15)


@pytest.mark.parametrize("std_rad", [(), (np.inf,) * 26], ids=["bag does not tell", "network knew nothing"])
def test_without_a_finite_std_nothing_is_said_to_be_known(
    make_run: MakeRun, std_rad: tuple[float, ...]
) -> None:
    run = read_run(make_run([Trial(std_rad=std_rad)]))
    (trial,) = run.drawn
    assert run.notes == ()
    assert not trial.is_std_known
    assert np.isnan(trial.share_within_two_std)


def test_the_share_within_the_band_counts_where_there_is_one(make_run: MakeRun) -> None:
    """The error is 0.05 rad throughout: outside of twice 0.02, inside of twice 0.03 rad."""
    std_rad = (0.02,) * 5 + (0.03,) * 15 + (np.inf,) * 6
    (trial,) = read_run(make_run([Trial(std_rad=std_rad)])).drawn
    assert trial.is_std_known
    assert trial.share_within_two_std == 0.75
