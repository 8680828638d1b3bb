"""What the tests of all folders share."""

from __future__ import annotations

import gc
import sys
from collections.abc import Generator, Iterator
from pathlib import Path

import pytest
from ros_domain import held_domains

sys.path.insert(0, str(Path(__file__).parent / "core"))  # tests of all layers use its made-up recordings


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Collect tests without looking for garbage: there is none, and it would take a quarter of the time."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


@pytest.fixture
def ros_domains() -> Iterator[Iterator[int]]:
    """Return ROS domains that no other test has, here or in another run of the tests, until this one ends."""
    with held_domains() as domains:
        yield domains


@pytest.fixture(autouse=True)
def own_profiles(monkeypatch: pytest.MonkeyPatch) -> None:
    """Take back the choice of Fast DDS profiles that a test leaves behind: it depends on other variables."""
    monkeypatch.setenv("FASTRTPS_DEFAULT_PROFILES_FILE", "")
    monkeypatch.delenv("FASTRTPS_DEFAULT_PROFILES_FILE")
