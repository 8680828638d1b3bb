"""Each test has a ROS domain of its own, and whatever it started is ended with it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from graph_harness import Graph
from tel_process import COARSE, HANG_S, PAPER, StartTel, tel_practice

from tel_ros.recording.config_file import load_config

HERE = Path(__file__).parent


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Let tests of graphs take longer than others: each of their waits has a limit of its own."""
    for item in items:
        if HERE in item.path.parents and item.get_closest_marker("timeout") is None:
            item.add_marker(pytest.mark.timeout(5.0 * HANG_S))


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the option; it is known when this folder is named on the command line."""
    parser.addoption("--starts", type=int, default=1, help="how often the loop's first second is measured")


@pytest.fixture(autouse=True)
def domain(monkeypatch: pytest.MonkeyPatch, ros_domains: Iterator[int]) -> int:
    """Give the test a ROS domain that no other test has."""
    number = next(ros_domains)
    monkeypatch.setenv("ROS_DOMAIN_ID", str(number))
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    return number


@pytest.fixture
def tel(tmp_path: Path) -> Iterator[StartTel]:
    """Return a function that starts ``tel practice`` with overrides; whatever it started is ended."""
    with tel_practice(tmp_path) as start:
        yield start


@pytest.fixture
def graph(tmp_path: Path, domain: int) -> Iterator[Callable[..., Graph]]:
    """Return a function that starts nodes with overrides of the paper's configuration."""
    running: list[Graph] = []

    def start(names: list[str], *overrides: str) -> Graph:
        made = Graph(load_config(PAPER, (*COARSE, *overrides)), tmp_path / "graph", names, domain)
        running.append(made)
        return made.__enter__()

    yield start
    for made in running:
        made.__exit__()
