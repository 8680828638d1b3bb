"""Whole sweeps of tiny practice runs: results, failures, interruptions, workers that end."""

from __future__ import annotations

import csv
import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest
from click.testing import CliRunner, Result

from tel_lab.sweep.point import MEASURES, failure, run_point
from tel_lab.sweep.sweep import SweepFolder
from tel_lab.sweep.sweep_command import sweep
from tel_lab.workers import Workforce, has_ray
from tel_ros.core.errors import ConfigError
from tel_ros.core.practice.strategy import PlannedTrial
from tel_ros.recording.config_file import load_config

# Seconds on an idle machine; workers load the physics anew, which takes its time on a busy one.
pytestmark = pytest.mark.timeout(300)

PAPER = str(Path(__file__).parents[2] / "config" / "paper.yaml")
TINY = [
    *("--set", "practice.trials=1"),
    *("--set", "practice.strategy=direct"),
    *("--set", "control.rate_hz=100"),
    *("--set", "sim.physics_rate_hz=1000"),
    *("--set", "practice.goal_duration_s=3"),
]
GRID = ["--grid", "sim.inertia_scale=0.5,1,1.5"]
ONE_PROCESS = ["--executor", "processes", "--jobs", "1"]


def run(*arguments: str) -> Result:
    return CliRunner().invoke(sweep, [PAPER, *TINY, *arguments])


def table(folder: Path) -> list[dict[str, str]]:
    with (folder / "table.csv").open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


@pytest.fixture
def started(tmp_path: Path) -> Iterator[subprocess.Popen[str]]:
    """A sweep of three points, of which one is done and the next one under way."""
    code = "from tel_lab.sweep.sweep_command import sweep; sweep()"
    process = subprocess.Popen(
        [sys.executable, "-c", code, PAPER, *TINY, *GRID, *ONE_PROCESS, "--out", str(tmp_path / "out")],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    deadline = time.monotonic() + 150.0
    while not points(tmp_path / "out"):
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < deadline
        time.sleep(0.02)
    yield process
    process.kill()
    process.communicate()


def points(folder: Path) -> dict[str, int]:
    """Return the files of finished points and when each was written."""
    return {file.name: file.stat().st_mtime_ns for file in (folder / "points").glob("*.json")}


def test_a_value_that_cannot_be_practised_gives_a_failed_row_and_the_others_their_results(
    tmp_path: Path,
) -> None:
    out = tmp_path / "out"
    result = run("--grid", "practice.goal_duration_s=3,0.5", *ONE_PROCESS, "--out", str(out), "--json")
    assert result.exit_code == 1
    assert "1 of 2 points failed" in result.stderr
    good, failed = json.loads(result.stdout)
    assert (good["outcome"], good["trials"], good["goal_reached"], good["aborts"]) == (
        "completed",
        1,
        True,
        0,
    )
    assert 0.0 < good["rms_final_rad"] < good["max_error_rad"] < 1.0
    assert good["duration_reached_s"] == 3.0
    assert good["arm_s"] > 3.0
    assert 0.5 < good["goal_effort_ratio"] < 1.0  # 16.9 N·m of 20 at 3 s
    assert failed["outcome"] == "failed"
    assert "elbow would move at" in failed["message"]
    assert [row["practice.goal_duration_s"] for row in table(out)] == ["3.0", "0.5"]
    assert [row["outcome"] for row in table(out)] == ["completed", "failed"]


@pytest.mark.parametrize(
    ("arguments", "parts"),
    [
        (["--grid", "sim.inertia_scal=1"], ["sim.inertia_scal", "a known key"]),
        (["--grid", "sim.inertia_scale=heavy"], ["sim.inertia_scale", "'heavy'", "a finite number"]),
        (["--jobs", "0"], ["--jobs is 0"]),
        (["--address", "auto", "--executor", "processes"], ["--address", "auto"]),
        (["--grid", "run.arm=external"], ["run.arm", "'sim'"]),
        (["--plan", "nowhere.yaml"], ["nowhere.yaml", "no such file"]),
    ],
)
def test_wrong_input_is_named_in_one_line_and_nothing_is_made(
    tmp_path: Path, arguments: list[str], parts: list[str]
) -> None:
    result = run(*arguments, "--out", str(tmp_path / "out"))
    assert (result.exit_code, result.stdout) == (2, "")
    assert len(result.stderr.strip().splitlines()) == 1
    for part in parts:
        assert part in result.stderr
    assert not (tmp_path / "out").exists()


def test_a_killed_sweep_goes_on_where_it_was_and_leaves_no_process(
    tmp_path: Path, started: subprocess.Popen[str]
) -> None:
    workers = psutil.Process(started.pid).children(recursive=True)
    assert workers
    started.send_signal(signal.SIGKILL)
    started.wait()
    _, alive = psutil.wait_procs(workers, timeout=20.0)
    assert alive == []
    before = points(tmp_path / "out")
    assert 1 <= len(before) < 3
    result = run(*GRID, *ONE_PROCESS, "--out", str(tmp_path / "out"))
    assert result.exit_code == 0
    after = points(tmp_path / "out")
    assert len(after) == 3
    assert before.items() <= after.items()
    assert [row["sim.inertia_scale"] for row in table(tmp_path / "out")] == ["0.5", "1.0", "1.5"]


def test_an_interrupted_sweep_says_how_far_it_came_and_leaves_a_table_of_that(
    tmp_path: Path, started: subprocess.Popen[str]
) -> None:
    workers = psutil.Process(started.pid).children(recursive=True)
    os.kill(started.pid, signal.SIGINT)
    _, err = started.communicate(timeout=30.0)
    assert started.returncode == 130
    done = len(points(tmp_path / "out"))
    assert 1 <= done < 3
    assert f"interrupted: {done} of 3 points are done; the same command goes on" in err
    assert len(table(tmp_path / "out")) == done
    _, alive = psutil.wait_procs(workers, timeout=20.0)
    assert alive == []


def test_a_plan_with_a_map_gives_a_figure_beside_the_table(tmp_path: Path) -> None:
    plan = tmp_path / "plan.yaml"
    grid = "{sim.inertia_scale: [1], practice.goal_duration_s: [3]}"
    axes = "{x: sim.inertia_scale, y: practice.goal_duration_s, tolerance_rad: 0.01}"
    plan.write_text(f"grid: {grid}\nmap: {axes}\n")
    out = tmp_path / "out"
    result = run("--plan", str(plan), *ONE_PROCESS, "--out", str(out))
    assert result.exit_code == 0, result.output
    assert {str(out / name) for name in ("table.csv", "map.png", "map.svg")} <= {*result.stdout.split()}


def test_a_folder_of_another_sweep_or_of_anything_else_is_refused_and_left_alone(tmp_path: Path) -> None:
    other, full = tmp_path / "other", tmp_path / "full"
    for folder in (other, full):
        folder.mkdir()
        (folder / "table.csv").write_text("kept")
    (other / "sweep.yaml").write_text("points: 0123456789abcdef\n")
    for folder, found in ((other, "holds another sweep"), (full, "is not empty")):
        result = run("--grid", "sim.inertia_scale=1", *ONE_PROCESS, "--out", str(folder))
        assert (result.exit_code, result.stdout) == (2, "")
        assert result.stderr.startswith(f"tel: {folder}: {found}; expected a new folder")
        assert (folder / "table.csv").read_text() == "kept"


def test_a_run_that_breaks_off_keeps_what_its_trials_gave(monkeypatch: pytest.MonkeyPatch) -> None:
    from tel_lab.offline import OfflinePractice
    from tel_ros.core.errors import TrainingError
    from tel_ros.core.practice.session import PractisedTrial

    whole = OfflinePractice.run_trial

    def second_fails(practice: OfflinePractice, plan: PlannedTrial) -> PractisedTrial:
        if plan.index == 2:
            raise TrainingError("hardly anything to learn from")
        return whole(practice, plan)

    monkeypatch.setattr(OfflinePractice, "run_trial", second_fails)
    result = run_point(load_config(PAPER, [text for text in TINY if text != "--set"] + ["practice.trials=3"]))
    assert (result["outcome"], result["message"]) == ("failed", "hardly anything to learn from")
    assert (result["trials"], result["goal_reached"]) == (1, True)
    assert result["rms_first_rad"] == result["rms_final_rad"] > 0.0


def test_a_fault_in_one_point_becomes_its_result() -> None:
    ((key, result),) = Workforce(1).run(run_point, {"a": (None,)})
    assert key == "a"
    assert "AttributeError" in result.message


def test_points_that_failed_at_once_and_damaged_files_are_computed_again(tmp_path: Path) -> None:
    folder = SweepFolder(tmp_path)
    done = {**dict.fromkeys(MEASURES), "outcome": "completed"}
    folder.keep("done", done)
    folder.keep("failed", failure("the worker was killed"))
    folder.keep("failed_later", {**failure("nothing to learn from"), "trials": 3})
    (tmp_path / "points" / "torn.json").write_text('{"outcome": "comp')
    keys = ("done", "failed_later", "failed", "torn", "missing")
    assert [folder.is_done(key) for key in keys] == [True, True, False, False, False]
    assert folder.result("done") == done


def test_the_table_is_the_same_as_csv_and_parquet(tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    rows = [
        {"sim.coulomb_friction_nm": [0.1, 0.2], "seed": 1, "rms_final_rad": 0.1 + 0.2, "message": 'a "b", c'},
        {"sim.coulomb_friction_nm": [], "seed": 2, "rms_final_rad": None, "message": ""},
    ]
    csv_file, parquet_file = SweepFolder(tmp_path).write_table(rows)
    as_text = [
        {key: "" if value is None else str(value) for key, value in row.items()}
        for row in parquet.read_table(parquet_file).to_pylist()
    ]
    assert csv_file.name == "table.csv"
    assert as_text == table(tmp_path)
    assert float(as_text[0]["rms_final_rad"]) == 0.1 + 0.2
    assert as_text[0]["sim.coulomb_friction_nm"] == "[0.1, 0.2]"


def test_without_ray_processes_compute_and_an_address_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tel_lab.workers.has_ray", lambda: False)
    assert not Workforce(executor="auto").with_ray
    for executor, address in (("auto", "ray://head:10001"), ("ray", None)):
        with pytest.raises(ConfigError, match=r"tel_ros\[sweep\]"):
            Workforce(executor=executor, address=address)


def ray_processes(driver: int) -> list[psutil.Process]:
    """Return the processes of the Ray that a process started: its session is named after that process."""
    return [
        process
        for process in psutil.process_iter(["cmdline"])
        if re.search(rf"/session_[^/]*_{driver}/", " ".join(process.info["cmdline"] or []))
    ]


@pytest.mark.skipif(not has_ray(), reason="Ray is not installed (extra: sweep)")
def test_ray_gives_the_same_numbers_as_processes_and_leaves_no_process(tmp_path: Path) -> None:
    grid = ["--grid", "sim.inertia_scale=0.5"]
    code = "from tel_lab.sweep.sweep_command import sweep; sweep()"
    command = [sys.executable, "-c", code, PAPER, *TINY, *grid, "--out", str(tmp_path / "ray")]
    # In its own process: Ray leaves threads and signal handlers in the one that starts it.
    process = subprocess.Popen(
        [*command, "--executor", "ray", "--jobs", "1"], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE
    )
    _, err = process.communicate(timeout=200.0)
    assert process.returncode == 0, err
    _, alive = psutil.wait_procs(ray_processes(process.pid), timeout=20.0)
    assert alive == []
    assert run(*grid, *ONE_PROCESS, "--out", str(tmp_path / "processes")).exit_code == 0
    of_ray, of_processes = table(tmp_path / "ray"), table(tmp_path / "processes")
    for row in (*of_ray, *of_processes):
        del row["wall_s"]
    assert of_ray == of_processes
