"""Paths from a CSV of waypoints."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tel_ros.core.config import Config, PathConfig
from tel_ros.core.errors import ConfigError, InputFileError
from tel_ros.recording.waypoint_file import load_known_path, load_path, read_waypoints

JOINTS = ("shoulder", "elbow")


@pytest.fixture
def csv(tmp_path: Path) -> Callable[[str], Path]:
    """Write a file of waypoints."""

    def write(text: str) -> Path:
        file = tmp_path / "eight.csv"
        file.write_text(text, encoding="utf-8")
        return file

    return write


def test_waypoints_are_read_in_the_order_of_the_joints(csv: Callable[[str], Path]) -> None:
    file = csv("elbow, shoulder\n1.0, 0.5\n1.5e0,-0.25\n\n2,0\n")
    np.testing.assert_array_equal(read_waypoints(file, JOINTS), [[0.5, 1.0], [-0.25, 1.5], [0.0, 2.0]])


def test_a_file_with_the_line_ends_of_another_system_is_read_too(csv: Callable[[str], Path]) -> None:
    file = csv("shoulder,elbow\r\n0,1\r\n1,0\r\n")
    np.testing.assert_array_equal(read_waypoints(file, JOINTS), [[0, 1], [1, 0]])


def test_a_file_that_a_spreadsheet_has_marked_as_unicode_is_read_too(csv: Callable[[str], Path]) -> None:
    file = csv("\ufeffshoulder,elbow\n0,1\n1,0\n")
    np.testing.assert_array_equal(read_waypoints(file, JOINTS), [[0, 1], [1, 0]])


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("", "empty"),
        ("0.1,0.2\n0.3,0.4\n", "0.1, 0.2"),
        ("shoulder\n1\n2\n", "shoulder"),
        ("shoulder,wrist\n1,2\n3,4\n", "shoulder, wrist"),
        ("elbow,elbow\n1,2\n3,4\n", "elbow, elbow"),
        ("shoulder,elbow,time\n1,2,3\n3,4,5\n", "shoulder, elbow, time"),
    ],
)
def test_a_header_that_is_not_the_joints_is_refused(
    csv: Callable[[str], Path], text: str, found: str
) -> None:
    file = csv(text)
    with pytest.raises(InputFileError) as refusal:
        read_waypoints(file, JOINTS)
    expected = "expected the names of the joints: shoulder, elbow"
    assert str(refusal.value) == f"{file}: line 1 is {found}; {expected}"


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        ("1,2\n3\n", "line 3 has 1 value; expected 2"),
        ("\n1,2,3\n3,4\n", "line 3 has 3 values; expected 2"),
        ("1,2\nnan,3\n", "line 3: shoulder is 'nan'; expected a finite number in rad"),
        ("1,-inf\n3,4\n", "line 2: elbow is '-inf'; expected a finite number in rad"),
        ("1,\n3,4\n", "line 2: elbow is ''; expected a finite number in rad"),
        ("1, 90° \n3,4\n", "line 2: elbow is '90°'; expected a finite number in rad"),
        ("", "holds 0 waypoints; expected at least 2"),
        ("1,2\n", "holds 1 waypoint; expected at least 2"),
        ("1,2\n\n3,4\n3,4.0\n5,6\n", "line 5 repeats the waypoint before it; expected waypoints that differ"),
    ],
)
def test_malformed_rows_are_refused_with_line_value_and_expectation(
    csv: Callable[[str], Path], rows: str, said: str
) -> None:
    file = csv(f"shoulder,elbow\n{rows}")
    with pytest.raises(InputFileError) as refusal:
        read_waypoints(file, JOINTS)
    assert str(refusal.value) == f"{file}: {said}"


def test_a_missing_file_is_refused_with_its_name_and_key(tmp_path: Path) -> None:
    with pytest.raises(
        InputFileError, match=r"no\.csv: there is no such file; expected .*\(key path\.file\)"
    ):
        read_waypoints(tmp_path / "no.csv", JOINTS)


@pytest.mark.parametrize("content", [b"\xff\xfes\x00", b"shoulder,elbow\n1,\xff\n"])
def test_a_file_that_is_no_text_is_refused(tmp_path: Path, content: bytes) -> None:
    file = tmp_path / "eight.csv"
    file.write_bytes(content)
    with pytest.raises(InputFileError, match=r"eight\.csv: not readable .*; expected a CSV of waypoints"):
        read_waypoints(file, JOINTS)


def test_a_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputFileError, match=r"is a folder; expected a CSV of waypoints"):
        read_waypoints(tmp_path, JOINTS)


def test_a_path_by_name_is_the_built_in_one(config: Config) -> None:
    path = load_path(PathConfig(name="planar_loops"), config.arm)
    np.testing.assert_allclose(path.evaluate(np.zeros(1))[0], [[0.6, 1.3]], atol=1e-12)
    with pytest.raises(ConfigError, match=r"path\.name is 'figure_nine'; expected one of .*planar_loops"):
        load_path(PathConfig(name="figure_nine"), config.arm)


def test_a_path_from_a_file_goes_through_its_waypoints_and_has_its_name(
    config: Config, csv: Callable[[str], Path]
) -> None:
    file = csv("elbow,shoulder\n1.0,0.5\n1.5,-0.25\n2,0\n")
    path = load_path(PathConfig(file=str(file)), config.arm)
    assert (path.name, path.n_joints) == ("eight", 2)
    np.testing.assert_allclose(path.evaluate(np.array([0.0, 1.0]))[0], [[0.5, 1.0], [0.0, 2.0]], atol=1e-12)


def test_without_a_known_path_there_is_none(config: Config) -> None:
    assert load_known_path(PathConfig(name="planar_loops"), config.arm) is None


def test_a_known_path_is_built_in_or_goes_through_its_waypoints(
    config: Config, csv: Callable[[str], Path]
) -> None:
    built_in = load_known_path(PathConfig(name="planar_loops", known_name="planar_loops"), config.arm)
    assert built_in is not None and built_in.name == "planar_loops"
    file = csv("elbow,shoulder\n1.0,0.5\n1.5,-0.25\n2,0\n")
    known = load_known_path(PathConfig(name="planar_loops", known_file=str(file)), config.arm)
    assert known is not None
    np.testing.assert_allclose(known.evaluate(np.array([0.0, 1.0]))[0], [[0.5, 1.0], [0.0, 2.0]], atol=1e-12)


def test_complaints_about_a_known_path_name_its_key(config: Config, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"path\.known_name is 'figure_nine'; expected one .*planar_loops"):
        load_known_path(PathConfig(name="planar_loops", known_name="figure_nine"), config.arm)
    missing = PathConfig(name="planar_loops", known_file=str(tmp_path / "no.csv"))
    with pytest.raises(InputFileError, match=r"no\.csv: there is no such file; .* \(key path\.known_file\)"):
        load_known_path(missing, config.arm)


def test_several_paths_are_called_like_their_files_and_built_in_ones_may_be_among_them(
    csv: Callable[[str], Path], config: Config
) -> None:
    file = csv("shoulder,elbow\n0,1\n1,0\n")
    path = load_path(PathConfig(files=(str(file), "planar_loops")), config.arm)
    assert [each.name for each in path.library] == ["eight", "planar_loops"]
    start = [path.named(name).evaluate(np.zeros(1))[0][0] for name in ("", "eight", "planar_loops")]
    np.testing.assert_array_equal(start[:2], [[0, 1], [0, 1]])
    np.testing.assert_allclose(start[2], [0.6, 1.3])


@pytest.mark.parametrize(
    ("text", "second", "complaint"),
    [
        ("shoulder,elbow\n0,1\n1,0\n", "no.csv", r"no\.csv: there is no such file; .*key path\.files"),
        ("shoulder\n0\n1\n", "planar_loops", "line 1 is shoulder; expected the names of the joints"),
        ("shoulder,elbow\n0,1\n1,0\n", "planar_loops_3", r"path\.files is 'planar_loops_3'; .*for 2 joints"),
    ],
)
def test_one_of_several_paths_that_cannot_be_used_is_refused_by_name(
    text: str, second: str, complaint: str, csv: Callable[[str], Path], config: Config
) -> None:
    with pytest.raises((InputFileError, ConfigError), match=complaint):
        load_path(PathConfig(files=(str(csv(text)), second)), config.arm)
