"""Each test has a ROS domain of its own, and whatever it started is ended with it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from graph_harness import COARSE, PAPER, SHORT, Graph, TelProcess
from ros_domain import held_domains

from tel_ros.recording.config_file import load_config


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
def tel(tmp_path: Path) -> Iterator[Callable[..., TelProcess]]:
    """Return a function that starts ``tel practice`` with overrides; whatever it started is ended."""
    started: list[TelProcess] = []

    def start(
        *overrides: str,
        config: Path = PAPER,
        name: str = "run",
        more: tuple[str, ...] = (),
        **environment: str,
    ) -> TelProcess:
        folder = tmp_path / name
        arguments = ["practice", str(config), "--out", str(folder), "--no-report", "--json", *more]
        for override in overrides:
            arguments += ["--set", override]
        started.append(TelProcess(arguments, folder, environment))
        return started[-1]

    yield start
    for process in started:
        if process.process.poll() is None:
            process.kill()
            process.process.communicate(timeout=10.0)


@pytest.fixture(scope="session")
def whole_run(tmp_path_factory: pytest.TempPathFactory) -> TelProcess:
    """Return a finished run of ``SHORT`` that nothing has disturbed; whoever looks at one shares it."""
    folder = tmp_path_factory.mktemp("whole") / "run"
    arguments = ["practice", str(PAPER), "--out", str(folder), "--no-report", "--json"]
    arguments += [part for override in SHORT for part in ("--set", override)]
    with held_domains() as domains:
        environment = {"ROS_DOMAIN_ID": str(next(domains)), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
        run = TelProcess(arguments, folder, environment)
        run.finish(180.0)
    return run


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
