"""Files: those that come with packages, the shipped configurations; files that are replaced as a whole."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import BinaryIO

from tel_ros.core.errors import InputFileError

_PACKAGE = "package://"


def share_folder(package: str) -> Path:
    """Return a package's share folder, below whichever prefix its module is installed in."""
    spec = find_spec(package)
    if spec is None or spec.origin is None:
        raise InputFileError(package, "no such Python package", "an installation with `make setup`")
    for prefix in Path(spec.origin).parents:
        folder = prefix / "share" / package
        if folder.is_dir():
            return folder
    raise InputFileError(spec.origin, f"no share/{package} beside it", "a complete installation")


def named_file(name: str, folder: Path, key: str = "arm.urdf") -> Path:
    """Return the absolute path of a file that a configuration names, under ``key``, relative to a folder.

    ``package://NAME/path`` comes with an installed Python package
    (``package://pybullet_data/kuka_iiwa/model.urdf``) or with a ROS package in AMENT_PREFIX_PATH.
    """
    if not name.startswith(_PACKAGE):
        return (folder / name).resolve()
    package, _, inside = name.removeprefix(_PACKAGE).partition("/")
    # Only a name without dots is looked up without importing anything.
    spec = find_spec(package) if package.isidentifier() else None
    roots = [Path(root) for root in (spec and spec.submodule_search_locations) or ()]
    prefixes = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    roots += [Path(prefix) / "share" / package for prefix in prefixes if prefix and package]
    for root in roots:
        if (root / inside).is_file():
            return (root / inside).resolve()
    installed = [str(root) for root in roots if root.is_dir()]
    found = (
        f"no such file in {' or '.join(installed)}" if installed else f"no package {package!r} is installed"
    )
    raise InputFileError(name, found, f"a file of a package (key {key})")


def missing(path: Path, wanted: str = "file") -> str:
    """Return why there is no ``wanted``, "file" or "folder", at a path: it may be the other kind."""
    if path.exists():
        return "is a folder" if path.is_dir() else "is a file"
    return f"there is no such {wanted}"


def config_folder() -> Path:
    """Return the folder of the configurations, as it lies in a checkout or as it was installed."""
    checkout = Path(__file__).parents[2] / "config"
    return checkout if (checkout / "paper.yaml").is_file() else share_folder("tel_ros") / "config"


def shipped_configs() -> dict[str, Path]:
    """Return the practice runs that come with the package, by the name that stands for each."""
    return {path.stem: path for path in sorted(config_folder().glob("*.yaml"))}


def named_config(name: str) -> Path:
    """Return the file of that name, else the shipped configuration that a bare name stands for."""
    path = Path(name)
    if path.is_file() or path.name != name:
        return path
    shipped = shipped_configs()
    if name not in shipped:
        raise InputFileError(name, missing(path), f"a YAML file, or one of {', '.join(shipped)}")
    return shipped[name]


def summary_of(config_file: Path) -> str:
    """Return the first sentence of the comment that a configuration begins with; empty if it has none."""
    comment = []
    for line in config_file.read_text(encoding="utf-8").splitlines():
        if not line.startswith("#"):
            break
        comment.append(line.lstrip("# "))
    return re.split(r"(?<=\.)\s(?=[A-Z])", " ".join(comment), maxsplit=1)[0]


@contextmanager
def replacing(path: Path) -> Iterator[BinaryIO]:
    """Open a new file that takes the place of another one once it is whole and on the disk."""
    beside = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        with beside.open("wb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        beside.replace(path)
    finally:
        beside.unlink(missing_ok=True)
