"""Recordings and tables in CSV."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from made_up_recording import JOINTS, motion_at

from tel_ros.core.errors import ConfigError, InputFileError
from tel_ros.recording.foreign.csv_files import read_csv_recording, read_movement, read_table

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
        ("time_s", "seconds", ["columns seconds", "expected a CSV with the columns time_s"]),
        ("tau_", "current_", ["tells no effort", "tau_<joint>"]),
        ("1.6", "nan", ["line 3: tau_elbow is 'nan'; expected a finite number"]),
        ("1.6", "much", ["line 3: tau_elbow is 'much'"]),
        ("1.6", "", ["line 3: tau_elbow is ''"]),
        ("1.6", '"1,6"', ["line 3: tau_elbow is '1,6'; expected a decimal point, not a comma"]),
        ("7,    0.5,", "0.5,", ["line 3 has 6 values; expected 7, as in its header"]),
        ("note", "q_elbow", ["q_elbow twice"]),
        (", q_gripper", "", ["line 2 has 7 values; expected 6, as in its header, with decimal points"]),
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


PLAIN = "time_s,note,q_a,tau_a,q_b\n0,x,0.1,1.5,0\n0.01,y,0.2,-2,0\n"


@pytest.mark.parametrize(
    "content",
    [
        PLAIN,
        PLAIN.replace(",", ";"),
        PLAIN.replace(",", "\t"),
        PLAIN.replace("\n", "\r\n"),
        PLAIN.replace("\n", ",\n"),
        PLAIN.replace(",", " ,  "),
        "\ufeff" + PLAIN,
        "# made by hand\n\n" + PLAIN.replace("\n", "\n# a comment\n\n"),
        "# two lines,\n# " + PLAIN.replace("x", "1").replace("y", "2"),
        PLAIN.replace("0.1,", '"0.1",').replace("1.5", '"1.5"'),
        PLAIN.replace("x", "").replace("y", '"a, ""b""\nc"'),
        PLAIN.replace("note", "q_c").replace("x", "").replace("y", "none"),
        PLAIN.replace("note", "dq_a").replace("x", "nan"),
        PLAIN.replace("note", "q_b").replace("x", "0"),
        PLAIN.replace("note", "").replace("x", "\u00b0"),
        PLAIN.replace("1.5,0", "1.5,nan"),
    ],
)
@pytest.mark.parametrize("encoding", ["utf-8", "utf-16", "latin-1"])
def test_whatever_a_program_makes_of_a_csv_the_columns_that_are_needed_are_read(
    tmp_path: Path, content: str, encoding: str
) -> None:
    if encoding == "latin-1" and content.startswith("\ufeff"):
        pytest.skip("there is no such mark in this encoding")
    (tmp_path / "recording.csv").write_bytes(content.encode(encoding))
    found = read_csv_recording(tmp_path / "recording.csv").of(["a"])
    np.testing.assert_allclose(found.time_s, [0.0, 0.01])
    np.testing.assert_array_equal(found.position_rad, [[0.1], [0.2]])
    np.testing.assert_array_equal(found.effort_nm, [[1.5], [-2.0]])


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (
            PLAIN,
            PLAIN.replace(",", ";").replace(".", ","),
            "line 2: q_a is '0,1'; expected a decimal point",
        ),
        ("0.01,", "-1,", "line 3: time_s is -1 after 0; expected rows in the order of time"),
        ("0.2", "", "line 3: q_a is ''; expected a finite number"),
        ("note", "tau_a", "has tau_a twice"),
    ],
)
def test_what_is_wrong_in_a_needed_column_is_told_with_its_line(
    tmp_path: Path, old: str, new: str, said: str
) -> None:
    file = tmp_path / "recording.csv"
    file.write_text(PLAIN.replace(old, new))
    with pytest.raises(InputFileError) as caught:
        read_csv_recording(file)
    assert str(caught.value).startswith(f"{file}: {said}")


def test_a_movement_needs_no_efforts_and_does_not_ask_for_them(tmp_path: Path) -> None:
    with pytest.raises(InputFileError) as caught:
        read_movement(tmp_path / "nowhere.csv", JOINTS, None, 100.0)
    assert "tau_" not in str(caught.value)


@pytest.mark.parametrize("content", [b"", b"time_s,q_a,tau_a\n"])
def test_a_file_without_rows_is_refused(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "empty.csv").write_bytes(content)
    with pytest.raises(InputFileError, match="has no rows"):
        read_table(tmp_path / "empty.csv")


def test_a_file_that_is_not_there_or_no_text_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputFileError, match="there is no such file"):
        read_table(tmp_path / "nowhere.csv")
    (tmp_path / "binary.csv").write_bytes(b"\x00\xff\xfe\x81")
    with pytest.raises(InputFileError, match="not readable"):
        read_table(tmp_path / "binary.csv")


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
    with pytest.raises(ConfigError, match="--duration-s is ''; expected a time in s"):
        read_movement(file, JOINTS, None, 50.0)


def test_a_movement_with_times_takes_no_duration(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="--duration-s is 2.0; expected nothing"):
        read_movement(write(tmp_path / "m.csv", "q_"), JOINTS, 2.0, 50.0)


def test_malformed_movements_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputFileError, match="5 points without velocities"):
        read_movement(write(tmp_path / "few.csv", "q_", rows=slice(5)), JOINTS, None, 50.0)
    with pytest.raises(
        InputFileError, match="line 3: time_s is 1.98 after 1.99; expected times that increase"
    ):
        read_movement(write(tmp_path / "back.csv", "q_", rows=slice(None, None, -1)), JOINTS, None, 50.0)
    with pytest.raises(InputFileError, match="has no column q_wrist"):
        read_movement(write(tmp_path / "m.csv", "q_"), ("elbow", "wrist"), None, 50.0)
