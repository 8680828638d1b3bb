"""Movements that torques are wanted for."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from made_up_recording import JOINTS, motion_at

from tel_ros.core.errors import ConfigError, InputFileError
from tel_ros.recording.foreign.movement_file import read_movement

TIME_S = np.arange(200) / 100.0
INPUTS = motion_at(TIME_S)


def write(file: Path, *prefixes: str, rows: slice = slice(None)) -> Path:
    """Write some of q, dq, ddq of the two joints, the elbow first."""
    columns, names = [TIME_S], ["time_s"]
    for prefix in prefixes:
        kind = ("q_", "dq_", "ddq_").index(prefix)
        for joint in ("elbow", "shoulder"):
            columns.append(INPUTS[:, 2 * kind + JOINTS.index(joint)])
            names.append(prefix + joint)
    np.savetxt(file, np.column_stack(columns)[rows], delimiter=",", header=",".join(names), comments="")
    return file


def test_what_the_file_tells_is_taken(tmp_path: Path) -> None:
    time_s, inputs = read_movement(write(tmp_path / "m.csv", "ddq_", "q_", "dq_"), JOINTS, None, 100.0)
    np.testing.assert_allclose(time_s, TIME_S)
    np.testing.assert_allclose(inputs, INPUTS)


@pytest.mark.parametrize("prefixes", [("q_",), ("q_", "dq_"), ("q_", "ddq_")])
def test_what_it_does_not_tell_follows_from_the_positions(tmp_path: Path, prefixes: tuple[str, ...]) -> None:
    _, inputs = read_movement(write(tmp_path / "m.csv", *prefixes), JOINTS, None, 100.0)
    np.testing.assert_allclose(inputs[10:-10], INPUTS[10:-10], atol=1e-4)


def test_waypoints_become_a_movement_of_the_given_duration(tmp_path: Path) -> None:
    file = tmp_path / "waypoints.csv"
    file.write_text("elbow,shoulder\n0.1,0.2\n0.5,0.9\n")
    time_s, inputs = read_movement(file, JOINTS, 2.0, 50.0)
    assert len(time_s) == 101
    assert time_s[-1] == pytest.approx(2.0)
    np.testing.assert_allclose(inputs[0], [0.2, 0.1, 0, 0, 0, 0], atol=1e-9)
    np.testing.assert_allclose(inputs[-1], [0.9, 0.5, 0, 0, 0, 0], atol=1e-9)
    with pytest.raises(ConfigError, match="--duration-s is None; expected a time in s"):
        read_movement(file, JOINTS, None, 50.0)


def test_a_movement_with_times_takes_no_duration(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="--duration-s is 2.0; expected nothing"):
        read_movement(write(tmp_path / "m.csv", "q_"), JOINTS, 2.0, 50.0)


def test_malformed_movements_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputFileError, match="5 points without velocities"):
        read_movement(write(tmp_path / "few.csv", "q_", rows=slice(5)), JOINTS, None, 50.0)
    with pytest.raises(InputFileError, match="the time of row 2 is .* expected times that increase"):
        read_movement(write(tmp_path / "back.csv", "q_", rows=slice(None, None, -1)), JOINTS, None, 50.0)
    with pytest.raises(InputFileError, match="has no column q_wrist"):
        read_movement(write(tmp_path / "m.csv", "q_"), ("elbow", "wrist"), None, 50.0)
