"""ROS's own linters pass, with the conventions of this package in place of theirs.

Lines may have 110 characters and strings double quotes (``ruff format``); docstrings are Google's.
There is no header in each file: LICENSE holds for all of them, so ``ament_copyright`` is not run.
"""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SOURCES = [str(ROOT / name) for name in ("tel_ros", "sim_bridge", "tel_lab", "launch")]
FLAKE8 = """
[flake8]
# Docstrings are for pep257; layout (E203, E501, W503), imports (F401, I) and quotes (Q) for ruff.
extend-ignore = D,E203,E501,F401,W503,I,Q
"""


@pytest.mark.timeout(300)
def test_flake8(tmp_path: Path) -> None:
    pytest.importorskip("flake8")
    linter = pytest.importorskip("ament_flake8.main")
    (tmp_path / "flake8.ini").write_text(FLAKE8, encoding="utf-8")
    code, errors = linter.main_with_errors(["--config", str(tmp_path / "flake8.ini"), *SOURCES])
    assert code == 0, "\n".join(errors)


@pytest.mark.timeout(300)
def test_pep257() -> None:
    pytest.importorskip("pydocstyle")
    linter = pytest.importorskip("ament_pep257.main")
    # A class explains its construction; click wants a character (D301); D402 sees signatures in prose.
    options = ["--convention", "google", "--add-ignore", "D104", "D105", "D107", "D301", "D402"]
    assert linter.main([*SOURCES, *options]) == 0


@pytest.mark.parametrize("file", ["package.xml", "interfaces/package.xml"])
def test_xmllint(file: str) -> None:
    linter = pytest.importorskip("ament_xmllint.main")
    if shutil.which("xmllint") is None:
        pytest.skip("needs xmllint")
    assert linter.main([str(ROOT / file)]) == 0
