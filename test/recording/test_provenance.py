"""A bag keeps the files of its configuration byte for byte; a run says which code it was made with."""

from __future__ import annotations

import dataclasses
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from synthetic_trial import METADATA, SyntheticTrial

from tel_ros import __version__
from tel_ros.core.config import Config, RecordingConfig, with_files
from tel_ros.recording import provenance
from tel_ros.recording.config_file import dump_config
from tel_ros.recording.provenance import git_revision, stored_files, unpacked_config, versions
from tel_ros.recording.trial_bag import read_metadata

TABS = "<robot>\n\t<link/>\n\t\t<!-- longer than what the writer of YAML puts on a line of its own -->\n\t\n"
NASTY = {
    "tabs": TABS.encode(),
    "trailing spaces": b"a  \n  b \n\n \n" * 9,
    "crlf": TABS.replace("\n", "\r\n").encode(),
    "bom": b"\xef\xbb\xbf<robot/>",
    "long": b"x" * 5000 + b" " * 200 + b"word " * 500,
    "latin": "\u00e9paule\u0085\u00a0".encode("latin-1"),
    "binary": bytes(range(256)),
    "like ours": b"base64:AAAA",
    "empty": b"",
}
needs_git = pytest.mark.skipif(shutil.which("git") is None, reason="makes a checkout")


@pytest.mark.parametrize("content", NASTY.values(), ids=NASTY)
@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_every_byte_of_a_file_and_every_text_survives_in_a_bag(
    trial: SyntheticTrial, config: Config, tmp_path: Path, content: bytes, storage: str
) -> None:
    file = tmp_path / "some.file"
    file.write_bytes(content)
    named = with_files(config, {"arm.urdf": str(file), "learning.start_from": str(file)})
    text = content.decode("latin-1")
    named = dataclasses.replace(named, arm=dataclasses.replace(named.arm, name=text))
    kept = {"config": dump_config(named), "reason": text, **stored_files(named, 1)}
    recording = RecordingConfig(storage=storage)  # type: ignore[arg-type]
    bag = trial.write(tmp_path / "bag", METADATA | kept, recording=recording)
    metadata = read_metadata(bag)
    assert metadata == METADATA | kept
    (tmp_path / "out").mkdir()
    unpacked = unpacked_config(bag, metadata, tmp_path / "out")
    assert unpacked.arm.name == text
    assert Path(unpacked.arm.urdf).read_bytes() == content
    assert Path(unpacked.learning.start_from).read_bytes() == content


def test_a_bag_of_an_earlier_version_holds_its_text_files_as_they_are(config: Config, tmp_path: Path) -> None:
    metadata = {"config": dump_config(config), "file.arm.urdf": "<robot/>\n"}
    unpacked = unpacked_config(tmp_path / "bag", metadata, tmp_path)
    assert Path(unpacked.arm.urdf).read_text(encoding="utf-8") == "<robot/>\n"


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


@needs_git
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


@needs_git
def test_a_machine_without_git_is_no_reason_to_fail(checkout: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "")
    assert git_revision(checkout) == ""


@needs_git
def test_versions_are_those_that_run(checkout: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(provenance, "CHECKOUT", checkout)
    found = versions()
    assert (found["tel_ros"], found["numpy"]) == (__version__, np.__version__)
    assert found["revision"] == git(checkout, "rev-parse", "HEAD")
