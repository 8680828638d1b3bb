"""The configurations that come with the package, by name."""

from __future__ import annotations

import re
from pathlib import Path

from tel_ros.recording.shared_files import share_folder


def config_folder() -> Path:
    """Return the folder of the configurations, as it lies in a checkout or as it was installed.

    Raises:
        InputFileError: there is neither.
    """
    checkout = Path(__file__).parents[2] / "config"
    return checkout if (checkout / "paper.yaml").is_file() else share_folder("tel_ros") / "config"


def shipped_configs() -> dict[str, Path]:
    """Return the practice runs that come with the package, by the name that stands for each.

    Raises:
        InputFileError: the package is not installed completely.
    """
    return {path.stem: path for path in sorted(config_folder().glob("*.yaml"))}


def summary_of(config_file: Path) -> str:
    """Return the first sentence of the comment that a configuration begins with; empty if it has none."""
    comment = []
    for line in config_file.read_text(encoding="utf-8").splitlines():
        if not line.startswith("#"):
            break
        comment.append(line.lstrip("# "))
    return re.split(r"(?<=\.)\s(?=[A-Z])", " ".join(comment), maxsplit=1)[0]
