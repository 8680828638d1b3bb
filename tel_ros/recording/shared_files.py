"""Finding the files that come with a package."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

from tel_ros.core.errors import InputFileError


def share_folder(package: str) -> Path:
    """Return a package's share folder, below whichever prefix its Python module is installed in.

    The ament index would need an environment that has been sourced; this works without one as well.

    Raises:
        InputFileError: the package is not installed, or has no such folder.
    """
    spec = find_spec(package)
    if spec is None or spec.origin is None:
        raise InputFileError(package, "no such Python package", "an installation with `make setup`")
    for prefix in Path(spec.origin).parents:
        folder = prefix / "share" / package
        if folder.is_dir():
            return folder
    raise InputFileError(spec.origin, f"no share/{package} beside it", "a complete installation")
