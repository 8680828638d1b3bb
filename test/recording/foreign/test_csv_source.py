"""Recordings and tables in CSV."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tel_ros.core.errors import InputFileError
from tel_ros.recording.foreign.csv_source import read_csv_recording, read_table

GOOD = """\
time_s, tau_elbow, q_elbow, note, q_shoulder, tau_shoulder, q_gripper
10.00,  1.5,       0.1,     7,    0.4,        -2,           0.02
10.01,  1.6,       0.2,     7,    0.5,        -2.5,         0.02
"""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """Of columns in any order, one of which nobody asks for."""
    (tmp_path / "recording.csv").write_text(GOOD, encoding="utf-8-sig")
    return tmp_path / "recording.csv"


def test_columns_are_found_by_their_names(file: Path) -> None:
    found = read_csv_recording(file).of(["shoulder", "elbow"])
    np.testing.assert_allclose(found.time_s, [0.0, 0.01])
    np.testing.assert_array_equal(found.position_rad, [[0.4, 0.1], [0.5, 0.2]])
    np.testing.assert_array_equal(found.effort_nm, [[-2.0, 1.5], [-2.5, 1.6]])


def test_a_joint_without_torque_only_holds_its_place(file: Path) -> None:
    found = read_csv_recording(file)
    assert found.with_effort() == ("elbow", "shoulder")
    assert found.ranges_rad()["gripper"] == (0.02, 0.02)
    with pytest.raises(InputFileError, match="has no column tau_gripper"):
        read_csv_recording(file, ["elbow", "gripper"])


@pytest.mark.parametrize(
    ("old", "new", "parts"),
    [
        ("time_s", "seconds", ["columns seconds", "expected the columns time_s"]),
        ("tau_", "current_", ["tells no effort", "tau_<joint>"]),
        ("1.6", "nan", ["tau_elbow is nan in row 2"]),
        ("1.6", "much", ["not readable", "much"]),
        ("7,    0.5,", "0.5,", ["not readable"]),
        ("note", "q_elbow", ["q_elbow twice"]),
        (", q_gripper", "", ["7 values a row", "expected 6"]),
    ],
)
def test_a_malformed_file_is_refused(file: Path, old: str, new: str, parts: list[str]) -> None:
    text = file.read_text(encoding="utf-8")
    assert old in text
    file.write_text(text.replace(old, new), encoding="utf-8")
    with pytest.raises(InputFileError) as caught:
        read_csv_recording(file)
    assert str(caught.value).startswith(str(file))
    for part in parts:
        assert part in str(caught.value)


@pytest.mark.parametrize("content", [b"", b"time_s,q_a,tau_a\n"])
def test_a_file_without_rows_is_refused(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "empty.csv").write_bytes(content)
    with pytest.raises(InputFileError, match="has no rows"):
        read_table(tmp_path / "empty.csv")


def test_a_file_that_is_not_there_or_no_text_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputFileError, match="there is no such file"):
        read_table(tmp_path / "nowhere.csv")
    (tmp_path / "binary.csv").write_bytes(b"\xff\xfe\x00\xff")
    with pytest.raises(InputFileError, match="not readable"):
        read_table(tmp_path / "binary.csv")
