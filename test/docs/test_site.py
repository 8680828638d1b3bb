"""The documentation site builds without a warning, explains every key, and asks nobody for anything."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import click
import pytest
from code_blocks import ROOT

from tel_ros.app.cli import main
from tel_ros.recording.config_file import flat_values, load_config

pytest.importorskip("mkdocs")


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder)]
    environment = os.environ | {"NO_MKDOCS_2_WARNING": "1", "PYTHONPATH": str(ROOT)}
    run = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=500)
    assert run.returncode == 0, run.stdout + run.stderr
    assert "WARNING" not in run.stderr
    return folder


@pytest.mark.timeout(600)
def test_reading_a_page_fetches_nothing_from_elsewhere(site: Path) -> None:
    pages = sorted(site.rglob("*.html"))
    assert len(pages) > 25
    fetched = re.compile(
        r"<(?:script|img|iframe|link(?![^>]*rel=\"?canonical))[^>]*(?:src|href)=\"?(?:https?:)?//"
    )
    assert {page.name for page in pages if fetched.search(page.read_text(encoding="utf-8"))} == set()
    styles = "".join(style.read_text(encoding="utf-8") for style in site.rglob("*.css"))
    assert not re.search(r"url\([\"']?https?://", styles)


@pytest.mark.timeout(600)
def test_every_key_of_the_configuration_is_explained(site: Path) -> None:
    page = (site / "reference" / "configuration.html").read_text(encoding="utf-8")
    config = load_config(ROOT / "config" / "paper.yaml")
    missing = [key for key in flat_values(config) if f"<code>{key.split('.')[-1]}</code>" not in page]
    assert missing == []


@pytest.mark.timeout(600)
def test_every_command_and_interface_has_its_place_in_the_reference(site: Path) -> None:
    commands = (site / "reference" / "commands.html").read_text(encoding="utf-8")
    names = main.list_commands(click.Context(main))
    assert [name for name in names if f'id="tel-{name}"' not in commands] == []
    interfaces = (site / "reference" / "interfaces.html").read_text(encoding="utf-8")
    files = [path for kind in ("action", "msg", "srv") for path in (ROOT / "interfaces" / kind).iterdir()]
    assert len(files) > 8
    assert [path.stem for path in files if path.stem not in interfaces] == []


@pytest.mark.timeout(600)
def test_every_page_can_be_reached_from_the_navigation() -> None:
    listed = (ROOT / "mkdocs.yml").read_text()
    pages = [path.relative_to(ROOT / "docs").as_posix() for path in (ROOT / "docs").rglob("*.md")]
    assert [page for page in pages if page not in listed] == []
