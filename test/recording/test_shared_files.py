"""Finding what comes with a package."""

from __future__ import annotations

from pathlib import Path

import pytest

from tel_ros.core.errors import InputFileError
from tel_ros.recording.shared_files import share_folder


@pytest.fixture
def prefix(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A place where a package ``grasp_msgs`` is installed as ROS does it."""
    module = tmp_path / "lib" / "python3" / "site-packages" / "grasp_msgs"
    module.mkdir(parents=True)
    (module / "__init__.py").touch()
    monkeypatch.syspath_prepend(str(module.parent))
    return tmp_path


def test_the_share_folder_lies_below_the_prefix_of_the_python_module(prefix: Path) -> None:
    (prefix / "share" / "grasp_msgs").mkdir(parents=True)
    assert share_folder("grasp_msgs") == prefix / "share" / "grasp_msgs"


def test_a_package_without_a_share_folder_is_refused(prefix: Path) -> None:
    with pytest.raises(
        InputFileError, match=r"grasp_msgs/__init__\.py: no share/grasp_msgs beside it; expected a"
    ):
        share_folder("grasp_msgs")


def test_a_package_that_is_not_installed_is_refused_with_what_to_do() -> None:
    with pytest.raises(InputFileError, match="no_such_package: .*expected an installation with `make setup`"):
        share_folder("no_such_package")
