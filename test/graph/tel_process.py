"""The command ``tel`` from a test: in a process of its own, or here."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import psutil
import pytest
from click.testing import CliRunner
from ros_domain import held_domains

from tel_ros.app.cli import main

ROOT = Path(__file__).parents[2]
PAPER = ROOT / "config" / "paper.yaml"
PATIENT = ("control.state_timeout_s=5.0", "sim.lockstep_timeout_s=10.0")
"""A machine that stands still for a second does not end a trial: time-outs are tested on their own."""
COARSE = ("control.rate_hz=200", "control.settle_time_s=0.2")
"""Ticks cost the tests most, next to starting processes; at 500 Hz there are more, and nothing else."""
COARSEST = ("control.rate_hz=100", "control.settle_time_s=0.2")
PRIORITY = ("control.realtime_priority=50",)
"""Where that is permitted, other processes make no stalls."""
HANG_S = 180.0
"""What has not come by then does not come. Nothing that works takes so long, on a busy machine either."""
QUICK = (
    *("practice.trials=3", "practice.first_duration_s=4.0", "practice.goal_duration_s=3.0"),
    *("control.approach_speed_rad_s=1.5", *COARSEST, *PATIENT),
)
"""A practice run of a few seconds."""


def wait_until(condition: Callable[[], bool], what: str) -> None:
    """Wait for a condition; fail the test when it does not come."""
    end = time.monotonic() + HANG_S
    while not condition():
        assert time.monotonic() < end, f"{what} did not come within {HANG_S} s"
        time.sleep(0.05)


class TelProcess:
    """The command ``tel`` in a process of its own.

    Args:
        arguments: after ``tel``.
        folder: of the run, if it makes one.
        environment: additional variables.
    """

    def __init__(self, arguments: list[str], folder: Path, environment: dict[str, str]) -> None:
        self.folder = folder
        self.process = subprocess.Popen(
            [sys.executable, "-m", "tel_ros.app.cli", *arguments],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            stdin=subprocess.DEVNULL,
            text=True,
            cwd=ROOT,
            env={**os.environ, **environment},
        )
        self._seen: dict[str, psutil.Process] = {}
        self._said: tuple[str, str] | None = None

    def nodes(self) -> dict[str, psutil.Process]:
        """Return the processes of the nodes that it has started so far."""
        try:
            children = psutil.Process(self.process.pid).children()
        except psutil.NoSuchProcess:
            children = []
        for child in children:
            try:
                module = child.cmdline()[2].split(".")
            except (psutil.NoSuchProcess, IndexError):
                continue
            self._seen[module[0] if module[0] == "sim_bridge" else module[-1]] = child
        return self._seen

    def wait_until_moving(self, trial: int) -> dict[str, psutil.Process]:
        """Wait until the controller has taken up a trial, and a moment longer; return the nodes."""
        log = self.folder / "log" / "ep_controller.log"
        wait_until(lambda: log.exists() and f"trial {trial}: " in log.read_text(), f"trial {trial}")
        time.sleep(0.3)
        return self.nodes()

    def finish(self) -> tuple[int, str, str]:
        """Wait for the end; return exit code, stdout and stderr."""
        if self._said is None:
            self.nodes()
            try:
                self._said = self.process.communicate(timeout=HANG_S)
            except subprocess.TimeoutExpired:
                self.kill()
                raise
        return self.process.returncode, *self._said

    def left_behind(self) -> list[str]:
        """Return the names of nodes that still run."""
        return [name for name, process in self._seen.items() if _runs(process)]

    def kill(self) -> None:
        """End everything at once."""
        for process in [*self.nodes().values(), psutil.Process(self.process.pid)]:
            if _runs(process):
                process.kill()


StartTel = Callable[..., TelProcess]


@contextmanager
def tel_practice(parent: Path) -> Iterator[StartTel]:
    """Give a function that starts ``tel practice`` with overrides below a folder; it is ended at the end."""
    started: list[TelProcess] = []

    def start(
        *overrides: str,
        config: Path = PAPER,
        name: str = "run",
        more: tuple[str, ...] = (),
        **environment: str,
    ) -> TelProcess:
        folder = parent / name
        arguments = ["practice", str(config), "--out", str(folder), "--no-report", "--json", *more]
        for override in overrides:
            arguments += ["--set", override]
        started.append(TelProcess(arguments, folder, environment))
        return started[-1]

    yield start
    for process in started:
        if process.process.poll() is None:
            process.kill()
            process.process.communicate(timeout=HANG_S)


@contextmanager
def own_domain() -> Iterator[int]:
    """Have what is started here use a ROS domain that nobody else has: for fixtures that tests share."""
    with held_domains() as domains, pytest.MonkeyPatch.context() as patch:
        number = next(domains)
        patch.setenv("ROS_DOMAIN_ID", str(number))
        patch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        yield number


def _runs(process: psutil.Process) -> bool:
    try:
        return process.is_running() and process.status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False


def tel_here(*arguments: str, answer: str = "") -> tuple[int, str, str]:
    """Run ``tel`` in this process; return exit code, stdout and stderr."""
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
    try:
        result = CliRunner().invoke(main, arguments, input=answer)
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
    return result.exit_code, result.stdout, result.stderr


def summary_of(out: str) -> dict[str, Any]:
    """Return the summary that ``tel practice --json`` has printed."""
    summary: dict[str, Any] = json.loads(out)
    return summary
