"""A wrong environment variable is named with its value, before ROS is even imported."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tel_ros.core.errors import ConfigError
from tel_ros.nodes.environment import choose_profiles, require_log_folder, require_usable

ROOT = Path(__file__).parents[2]
PROFILES = "FASTRTPS_DEFAULT_PROFILES_FILE"
VARIABLES = (
    *("ROS_DOMAIN_ID", "RMW_IMPLEMENTATION", "ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_STATIC_PEERS"),
    *("FASTRTPS_DEFAULT_PROFILES_FILE", "PYTHONPATH", "ROS_LOG_DIR", "ROS_HOME"),
)


@pytest.fixture(autouse=True)
def nothing_set(monkeypatch: pytest.MonkeyPatch) -> None:
    for variable in VARIABLES:
        monkeypatch.setenv(variable, "")  # so that what a test leaves there is undone
        monkeypatch.delenv(variable)


@pytest.mark.parametrize(
    ("variable", "value", "expected"),
    [
        ("ROS_DOMAIN_ID", "300", "a number from 0 to 232"),
        ("RMW_IMPLEMENTATION", "rmw_nowhere_cpp", "rmw_fastrtps_cpp"),
        ("RMW_IMPLEMENTATION", "rmw_implementation", "rmw_fastrtps_cpp"),
        ("ROS_AUTOMATIC_DISCOVERY_RANGE", "localhost", "SUBNET or LOCALHOST"),
        ("ROS_STATIC_PEERS", "127.0.0.1;no.such.host.invalid", "no.such.host.invalid"),
        ("FASTRTPS_DEFAULT_PROFILES_FILE", "/nowhere.xml", "No such file"),
        ("FASTRTPS_DEFAULT_PROFILES_FILE", __file__, "profiles"),
    ],
)
def test_a_wrong_value_is_named(
    monkeypatch: pytest.MonkeyPatch, variable: str, value: str, expected: str
) -> None:
    monkeypatch.setenv(variable, value)
    with pytest.raises(ConfigError) as found:
        require_usable()
    assert (found.value.key, found.value.value) == (variable, value)
    assert expected in str(found.value)


@pytest.mark.parametrize(
    ("variable", "value"),
    [
        *((variable, "") for variable in VARIABLES),
        ("RMW_IMPLEMENTATION", "rmw_fastrtps_cpp"),
        ("ROS_AUTOMATIC_DISCOVERY_RANGE", "OFF"),
        ("ROS_STATIC_PEERS", "127.0.0.1;localhost"),
        ("FASTRTPS_DEFAULT_PROFILES_FILE", str(ROOT / "config" / "fastdds.xml")),
        ("PYTHONPATH", "/opt/ros/none/lib/python3.10/site-packages"),
    ],
)
def test_what_ros_can_use_is_left_alone(monkeypatch: pytest.MonkeyPatch, variable: str, value: str) -> None:
    monkeypatch.setenv(variable, value)
    require_usable()


@pytest.mark.parametrize(
    ("given", "file", "range_after"),
    [
        ({}, "fastdds.xml", None),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"}, "fastdds.xml", "SUBNET"),
        # rmw_fastrtps would add shared memory.
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}, "fastdds_localhost.xml", "SYSTEM_DEFAULT"),
        (
            {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "ROS_STATIC_PEERS": "127.0.0.1"},
            *("fastdds.xml", "LOCALHOST"),
        ),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", PROFILES: "/mine.xml"}, "mine.xml", "LOCALHOST"),
        (
            {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp"},
            *(None, "LOCALHOST"),
        ),
    ],
)
def test_fast_dds_gets_our_profiles_unless_others_are_named(
    monkeypatch: pytest.MonkeyPatch, given: dict[str, str], file: str | None, range_after: str | None
) -> None:
    for variable, value in given.items():
        monkeypatch.setenv(variable, value)
    choose_profiles()
    assert (PROFILES in os.environ) == (file is not None)
    assert file is None or Path(os.environ[PROFILES]).name == file
    assert os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE") == range_after


@pytest.mark.parametrize("package", ["rclpy", "sensor_msgs"])
def test_packages_of_another_ros_are_told_by_their_libraries(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, package: str
) -> None:
    folder = tmp_path / package
    folder.mkdir()
    (folder / "__init__.py").touch()
    (folder / "library.cpython-310-x86_64-linux-gnu.so").touch()
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(ConfigError, match=f"{folder} is not for Python"):
        require_usable()


def test_a_log_folder_is_looked_for_where_rcl_looks(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.touch()
    monkeypatch.setenv("HOME", str(tmp_path))
    require_log_folder()
    monkeypatch.setenv("HOME", str(file))
    with pytest.raises(ConfigError, match=f"HOME is '{file}'; expected a folder that can be written"):
        require_log_folder()
    monkeypatch.delenv("HOME")
    with pytest.raises(ConfigError, match="HOME is 'unset'"):
        require_log_folder()
    monkeypatch.setenv("ROS_HOME", str(tmp_path))
    require_log_folder()
    monkeypatch.setenv("ROS_LOG_DIR", str(file / "below"))
    with pytest.raises(ConfigError, match="ROS_LOG_DIR"):
        require_log_folder()


@pytest.mark.parametrize(
    "module",
    [
        "tel_ros.nodes.ep_controller",
        "sim_bridge.node",
        "tel_ros.app.cli practice paper",
        "tel_ros.app.cli view paper",
    ],
)
def test_nodes_and_commands_end_with_one_line_and_code_2(module: str, tmp_path: Path) -> None:
    """In processes: rclpy itself would end them with code 102 while it is imported."""
    environment = os.environ | {"RMW_IMPLEMENTATION": "rmw_nowhere_cpp", "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, "-m", *module.split()], cwd=tmp_path, env=environment, capture_output=True, text=True
    )
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert "RMW_IMPLEMENTATION is 'rmw_nowhere_cpp'" in line
    assert list(tmp_path.iterdir()) == []
