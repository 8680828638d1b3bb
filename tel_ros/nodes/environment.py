"""Whether ROS can start with the environment variables as they are; if not, one line that names which.

ROS itself fails in a library's words, goes on with something else, or, for a middleware that is missing, ends
the process while rclpy is imported. So this is looked at when the package of the nodes is imported.
"""

from __future__ import annotations

import os
import socket
import sys
from importlib.machinery import EXTENSION_SUFFIXES, PathFinder
from pathlib import Path
from xml.etree import ElementTree

from tel_ros.core.errors import ConfigError, TelError
from tel_ros.local_stop import domain_id
from tel_ros.recording.shared_files import config_folder

_RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
_RANGES = ("SUBNET", "LOCALHOST", "OFF", "SYSTEM_DEFAULT")
_PROFILES = "FASTRTPS_DEFAULT_PROFILES_FILE"


def _wrong(variable: str, expected: str) -> ConfigError:
    return ConfigError(variable, os.environ.get(variable, "unset"), expected, "environment")


def require_usable() -> None:
    """Raise ConfigError if a variable keeps ROS from starting, or from doing what the variable says."""
    domain_id()
    _require_python_of_this_ros()
    if middleware := os.environ.get("RMW_IMPLEMENTATION"):
        prefixes = [sys.prefix, *os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)]
        indices = [Path(prefix, "share/ament_index/resource_index/rmw_typesupport") for prefix in prefixes]
        installed = {file.name for index in indices if index.is_dir() for file in index.iterdir()}
        installed.discard("rmw_implementation")  # the one that loads the others
        if installed and middleware not in installed:
            raise _wrong("RMW_IMPLEMENTATION", f"what is installed here: {', '.join(sorted(installed))}")
    if os.environ.get(_RANGE, "") not in ("", *_RANGES):
        raise _wrong(_RANGE, " or ".join(_RANGES))
    for peer in filter(None, os.environ.get("ROS_STATIC_PEERS", "").split(";")):
        try:
            socket.getaddrinfo(peer, None)
        except (OSError, UnicodeError):
            raise _wrong("ROS_STATIC_PEERS", f"addresses or known hosts, with ; between ({peer})") from None
    if profiles := os.environ.get(_PROFILES):
        try:
            ElementTree.parse(profiles)
        except (OSError, ElementTree.ParseError) as error:
            why = getattr(error, "strerror", None) or error
            raise _wrong(_PROFILES, f"a file of Fast DDS profiles ({why})") from None


def choose_profiles() -> None:
    """Have Fast DDS use our profiles, unless others are named: they keep it from using shared memory."""
    if _PROFILES in os.environ or "fastrtps" not in (os.environ.get("RMW_IMPLEMENTATION") or "fastrtps"):
        return
    file = "fastdds.xml"
    if os.environ.get(_RANGE) == "LOCALHOST" and not os.environ.get("ROS_STATIC_PEERS"):
        file, os.environ[_RANGE] = "fastdds_localhost.xml", "SYSTEM_DEFAULT"
    os.environ[_PROFILES] = str(config_folder() / file)


def require_log_folder() -> None:
    """Raise ConfigError if rcl could not write its log where it looks for a place: in this order."""
    places = {"ROS_LOG_DIR": "", "ROS_HOME": "log", "HOME": ".ros/log"}
    variable = next(filter(os.environ.get, places), "HOME")
    value = os.environ.get(variable, "")
    try:
        folder = Path(value, places[variable]).expanduser()
        folder.mkdir(parents=True, exist_ok=True)
        usable = bool(value) and os.access(folder, os.W_OK | os.X_OK)
    except OSError:
        usable = False
    if not usable:
        expected = "a folder that can be written (for the log; ROS_LOG_DIR names another)"
        raise _wrong(variable, expected)


def _require_python_of_this_ros() -> None:
    """Raise ConfigError if PYTHONPATH leads to packages of a ROS that was built for another Python."""
    named = {Path(part).resolve() for part in os.environ.get("PYTHONPATH", "").split(os.pathsep) if part}
    for package in ("rclpy", "sensor_msgs", "tel_interfaces"):
        spec = PathFinder.find_spec(package)
        for folder in map(Path, (spec and spec.submodule_search_locations) or ()):
            built_for = {f".{file.name.partition('.')[2]}" for file in folder.glob("*.so")}
            if folder.resolve().parent in named and built_for.isdisjoint(EXTENSION_SUFFIXES):
                python = f"Python {sys.version_info.major}.{sys.version_info.minor}"
                raise _wrong("PYTHONPATH", f"none of another ROS ({folder} is not for {python})")


def exit_unless_usable() -> None:
    """End the process with that line and exit code 2 where the environment is wrong."""
    try:
        require_usable()
    except TelError as error:
        print(f"tel: {error}", file=sys.stderr)
        sys.exit(2)
