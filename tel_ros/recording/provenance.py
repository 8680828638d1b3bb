"""What a run was made with: versions of the code, and the files that its configuration names, for its bags.

Files are stored in Base64: no writer of YAML keeps all bytes of a text. Text files are in every bag, a binary
file, such as the network that learning starts from, is in that of the first trial only.
"""

from __future__ import annotations

import base64
import binascii
import platform
import subprocess
from collections.abc import Mapping
from importlib import metadata as packages
from pathlib import Path

import yaml

from tel_ros import __version__
from tel_ros.core.config import Config, file_values, is_binary, with_files
from tel_ros.core.errors import BagError, TelError
from tel_ros.recording.config_file import config_from

CHECKOUT = Path(__file__).parents[2]
_PREFIX = "file."
_BASE64 = "base64:"
"""In front of contents; earlier versions wrote text as it is, and binary files without this mark."""
_PACKAGES = ("numpy", "scipy", "numba", "rosbags", "pybullet", "pin")
_GIT_TIMEOUT_S = 5.0


def stored_files(config: Config, trial: int) -> dict[str, str]:
    """Return the files that a configuration names, as keys of a trial's bag metadata to contents."""
    contents = {}
    for key, file in file_values(config).items():
        if trial == 1 or not is_binary(key):
            contents[_PREFIX + key] = _BASE64 + base64.b64encode(file.read_bytes()).decode("ascii")
    return contents


def stored_config(bag: Path, metadata: Mapping[str, str]) -> Config:
    """Return the configuration that a bag was recorded with; its files are named as in the run's folder."""
    try:
        return config_from(yaml.safe_load(metadata["config"]), lambda key: f"the configuration in {bag}")
    except KeyError:
        raise BagError(bag, "holds no configuration", "a bag that tel_ros has recorded") from None
    except (TelError, yaml.YAMLError, TypeError, AttributeError) as error:
        found = f"holds a configuration that cannot be used ({' '.join(str(error).split())})"
        raise BagError(bag, found, "that of a practice run") from error


def stored_urdf(bag: Path, metadata: Mapping[str, str]) -> bytes:
    """Return the URDF that a bag was recorded with; BagError if it is neither in the bag nor beside it."""
    return _content(bag, metadata, stored_config(bag, metadata), "arm.urdf")


def unpacked_config(bag: Path, metadata: Mapping[str, str], folder: Path) -> Config:
    """Return the configuration of a bag with its files written into a folder, under absolute names.

    Files that a bag of an earlier version does not hold are taken from the folder of its run.
    """
    config = stored_config(bag, metadata)
    names = {}
    for key in file_values(config):
        file = folder / key.replace(".", "_")
        file.write_bytes(_content(bag, metadata, config, key))
        names[key] = str(file)
    return with_files(config, names)


def _content(bag: Path, metadata: Mapping[str, str], config: Config, key: str) -> bytes:
    stored, binary = metadata.get(_PREFIX + key), is_binary(key)
    if stored is not None and not (binary or stored.startswith(_BASE64)):
        return stored.encode("utf-8")
    if stored is not None:
        try:
            return base64.b64decode(stored.removeprefix(_BASE64), validate=True)
        except binascii.Error as error:
            found = f"holds a {key} that is not readable ({error})"
            raise BagError(bag, found, "the file in Base64") from error
    beside = bag.parent / file_values(config)[key]
    try:
        return beside.read_bytes()
    except OSError:
        what = "the bag of the run's first trial" if binary else "a bag with all its files"
        found = f"does not hold {key}, and {beside} is not there"
        raise BagError(bag, found, f"{what}, or the whole folder of the run") from None


def versions() -> dict[str, str]:
    """Return the versions of us, Python and what results depend on; the revision of a checkout."""
    found = {"tel_ros": __version__, "python": platform.python_version()}
    revision = git_revision(CHECKOUT)
    if revision:
        found["revision"] = revision
    for package in _PACKAGES:
        try:
            found[package] = packages.version(package)
        except packages.PackageNotFoundError:
            continue
    return found


def git_revision(checkout: Path) -> str:
    """Return the commit of a checkout; empty if it is none, or git is not there or does not answer."""
    if not (checkout / ".git").exists():
        return ""
    command = ["git", "-C", str(checkout), "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=_GIT_TIMEOUT_S, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return done.stdout.strip()
