"""The launch file of practice under ROS's own launch: what it returns, and what it leaves alone."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest
import yaml
from tel_process import QUICK, ROOT

from tel_ros.recording.run_folder import read_summary

pytestmark = [
    pytest.mark.skipif(
        shutil.which("ros2") is None or not os.environ.get("COLCON_PREFIX_PATH"),
        reason="needs a ROS installation and a workspace that is sourced",
    ),
    pytest.mark.timeout(180),
]
LAUNCH_FILE = ROOT / "launch" / "practice.launch.py"


def launched(folder: Path, file: Path = LAUNCH_FILE, **arguments: str) -> subprocess.CompletedProcess[str]:
    """Launch a quick run and wait for the end of the launch."""
    values = {key: yaml.safe_load(value) for key, _, value in (each.partition("=") for each in QUICK)}
    parameters = folder / "quick.yaml"
    parameters.write_text(yaml.safe_dump({"/**": {"ros__parameters": values}}), encoding="utf-8")
    given = {"params_file": str(parameters), "log_level": "warn", **arguments}
    command = ["ros2", "launch", str(file), *(f"{name}:={value}" for name, value in given.items())]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=170)


def test_a_run_that_completes_ends_the_launch_with_0(tmp_path: Path) -> None:
    done = launched(tmp_path, config="paper", run_dir="run", namespace="left")
    assert done.returncode == 0, done.stdout + done.stderr
    assert read_summary(tmp_path / "run")["outcome"] == "completed"  # relative to the caller's folder


def test_a_run_that_fails_ends_the_launch_with_1(tmp_path: Path) -> None:
    done = launched(tmp_path, config="planar_arm", run_dir="run")  # adaptive: three trials are not enough
    assert done.returncode == 1
    assert "practice: stopped" in done.stdout + done.stderr


def test_as_a_part_of_a_larger_launch_it_ends_its_own_nodes_alone(tmp_path: Path) -> None:
    outer = tmp_path / "outer.launch.py"
    outer.write_text(
        f"""
from launch import LaunchDescription
from launch.actions import ExecuteProcess, IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource

def generate_launch_description():
    arguments = {{"config": "planar_arm", "run_dir": "run", "params_file": "quick.yaml", "log_level": "warn"}}
    ours = PythonLaunchDescriptionSource({str(LAUNCH_FILE)!r})
    other = "until grep -q stopped run/summary.json; do sleep 1; done; sleep 8; echo outlived"
    return LaunchDescription([
        IncludeLaunchDescription(ours, launch_arguments=arguments.items()),
        ExecuteProcess(cmd=["bash", "-c", other], output="screen"),
    ])
""",
        encoding="utf-8",
    )
    done = launched(tmp_path, outer)
    assert "outlived" in done.stdout and done.returncode == 1
