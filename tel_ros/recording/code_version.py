"""Which code a run was made with, as far as that can be told."""

from __future__ import annotations

import platform
import subprocess
from importlib import metadata
from pathlib import Path

from tel_ros import __version__

CHECKOUT = Path(__file__).parents[2]
_PACKAGES = ("numpy", "scipy", "numba", "rosbags", "pybullet", "pin")
_GIT_TIMEOUT_S = 5.0


def versions() -> dict[str, str]:
    """Return names and versions: ours, Python's, those of packages that results depend on.

    ``revision`` is the commit of a checkout, with ``-dirty`` behind it where files differ from that. Code
    that was installed has none.
    """
    found = {"tel_ros": __version__, "python": platform.python_version()}
    revision = git_revision(CHECKOUT)
    if revision:
        found["revision"] = revision
    for package in _PACKAGES:
        try:
            found[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
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
