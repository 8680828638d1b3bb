"""A run says which code it was made with."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from tel_ros import __version__
from tel_ros.recording import provenance
from tel_ros.recording.provenance import git_revision, versions

pytestmark = pytest.mark.skipif(shutil.which("git") is None, reason="makes a checkout")


def git(folder: Path, *arguments: str) -> str:
    who = ["-c", "user.name=somebody", "-c", "user.email=somebody@example.invalid"]
    command = ["git", "-C", str(folder), *who, *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    git(tmp_path, "init", "-q")
    (tmp_path / "code.py").write_text("first")
    git(tmp_path, "add", ".")
    git(tmp_path, "commit", "-q", "-m", "first")
    git(tmp_path, "tag", "-a", "1.0", "-m", "a tag that must not hide the commit")
    return tmp_path


def test_the_commit_of_a_checkout_and_whether_it_was_changed(checkout: Path) -> None:
    commit = git(checkout, "rev-parse", "HEAD")
    assert git_revision(checkout) == commit
    (checkout / "code.py").write_text("second")
    assert git_revision(checkout) == f"{commit}-dirty"


def test_what_is_no_checkout_has_no_commit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert git_revision(tmp_path) == ""
    (tmp_path / ".git").write_text("gitdir: nowhere")
    assert git_revision(tmp_path) == ""
    monkeypatch.setattr(provenance, "CHECKOUT", tmp_path)
    assert "revision" not in versions()


def test_a_machine_without_git_is_no_reason_to_fail(checkout: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "")
    assert git_revision(checkout) == ""


def test_versions_are_those_that_run(checkout: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(provenance, "CHECKOUT", checkout)
    found = versions()
    assert (found["tel_ros"], found["numpy"]) == (__version__, np.__version__)
    assert found["revision"] == git(checkout, "rev-parse", "HEAD")
