"""What the live view costs the control loop: the same trial without it, with it, and with somebody looking.

A row is one trial of ``tel practice`` with ``sim.clock: realtime``, its figures those that the controller
wrote into the bag. The three ways take turns, because a shared machine is not equally busy all the time; the
ratio is to the trial without the view of the same turn. Looking: a client of the page that takes all that is
sent, as a browser does; what a browser needs to draw it is not in these figures (``--browser`` puts a
headless Chromium that draws in software in its place).
"""

from __future__ import annotations

import contextlib
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import click

from tel_lab.studies.realtime_loop import ON_THIS_MACHINE, Figures, cpu_time_s, product
from tel_lab.study import ROOT, StudyOptions, study
from tel_lab.tables import Column, Table
from tel_ros.core.errors import TelError

WAYS = ("without", "view", "view, looked at", "without, again")
"""The last shows what a ratio is worth on this machine."""
_BROWSER = """
import sys, time
from playwright.sync_api import sync_playwright
with sync_playwright() as play:
    flags = ["--no-sandbox", "--disable-gpu", "--enable-unsafe-swiftshader"]
    browser = play.chromium.launch(executable_path="/usr/bin/chromium", args=flags)
    page = browser.new_page()
    page.goto(sys.argv[1], wait_until="commit", timeout=120_000)
    page.get_by_test_id("status").wait_for(timeout=120_000)
    print("looks", flush=True)
    time.sleep(3600)
"""
_CLIENT = "import sys, asyncio, tel_lab.studies.view_cost as v; asyncio.run(v.take_everything(sys.argv[1]))"


async def take_everything(link: str) -> None:
    """Open the page's socket and take all that comes."""
    import viser
    from websockets.asyncio.client import connect
    from websockets.typing import Origin, Subprotocol

    origin, _, token = link.partition("/?token=")
    cookie = f"tel_view_{origin.rpartition(':')[2]}={token}"
    headers = {"Cookie": cookie}
    async with connect(
        origin.replace("http", "ws"),
        origin=Origin(origin),
        additional_headers=headers,
        subprotocols=[Subprotocol(f"viser-v{viser.__version__}")],
        max_size=None,
    ) as socket:
        print("looks", flush=True)
        async for _ in socket:
            pass


@contextlib.contextmanager
def process(command: list[str]) -> Iterator[tuple[subprocess.Popen[str], str]]:
    started = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    try:
        line = started.stdout.readline().strip() if started.stdout else ""
        if not line:
            raise TelError(f"{command} ended with code {started.wait()}")
        yield started, line
    finally:
        started.terminate()
        started.wait()


def measure(
    way: str, config: Path, rate_hz: float, seconds: float, browser: bool, folder: Path, more: Sequence[str]
) -> tuple[Figures | None, float]:
    """Return the figures of a trial, and the share of a core that the view used meanwhile."""
    with contextlib.ExitStack() as stack:
        view = None
        if way in WAYS[1:3]:
            command = [sys.executable, "-m", "tel_ros.app.cli", "view", str(config)]
            view, line = stack.enter_context(process(command))
        if way == WAYS[2]:
            looker = _BROWSER if browser else _CLIENT
            stack.enter_context(process([sys.executable, "-c", looker, line.split()[-1]]))
        before_s, began = cpu_time_s(view.pid) if view else 0.0, time.monotonic()
        figures = product(config, rate_hz, seconds, 0, folder, more)
        used_s = cpu_time_s(view.pid) - before_s if view else 0.0
        return figures, used_s / (time.monotonic() - began)


@dataclass(frozen=True)
class Row:
    """One way: the figures of its turns, the view's share of a core, and p99 times that without the view."""

    way: str
    figures: list[Figures] = field(default_factory=list)
    cpu: list[float] = field(default_factory=list)
    ratio: list[float] = field(default_factory=list)


def _median(name: str, unit: float = 1.0) -> Callable[[Row], float]:
    return lambda row: unit * statistics.median(figures[name] for figures in row.figures)


def _p99(row: Row) -> str:
    p99 = [1e3 * figures["jitter_p99_s"] for figures in row.figures]
    return f"{statistics.median(p99):.2f} ({min(p99):.2f}–{max(p99):.2f})"


COLUMNS = [
    Column[Row]("", lambda row: row.way, left=True),
    Column("rate Hz", _median("state_rate_hz"), ".0f"),
    Column("jitter p50 ms", _median("jitter_p50_s", 1e3), ".3f"),
    Column("p99 ms (range)", _p99),
    Column("answered in time %", _median("in_time", 100.0), ".1f"),
    Column("p99, times that without", lambda row: statistics.median(row.ratio), ".2f"),
    Column("view, % of a core", lambda row: 100.0 * statistics.median(row.cpu), ".0f"),
]


@study()
@click.option("--config", type=click.Path(path_type=Path), default=ROOT / "config" / "paper.yaml")
@click.option("--rate", "rate_hz", default=500.0, show_default=True)
@click.option("--seconds", default=10.0, show_default=True, help="Of movement in each trial.")
@click.option("--turns", default=5, show_default=True)
@click.option("--browser", is_flag=True, help="Looked at with a headless Chromium.")
def view_cost(
    options: StudyOptions, config: Path, rate_hz: float, seconds: float, turns: int, browser: bool
) -> None:
    """What the live view costs the control loop."""
    os.environ.update(ON_THIS_MACHINE)
    rows = {way: Row(way) for way in WAYS}
    with tempfile.TemporaryDirectory() as folder:
        for turn in range(turns):
            load_1min, measured = os.getloadavg()[0], {}
            for way in WAYS:
                run = Path(folder) / f"{turn}_{way}"
                figures, cpu = measure(way, config, rate_hz, seconds, browser, run, options.overrides)
                if figures is not None:
                    measured[way] = (figures, cpu)
            if len(measured) < len(WAYS):
                print(f"turn {turn + 1}: a run failed; left out", file=sys.stderr)
                continue
            p99_ms = {way: 1e3 * figures["jitter_p99_s"] for way, (figures, _) in measured.items()}
            for way, (figures, cpu) in measured.items():
                rows[way].figures.append(figures)
                rows[way].cpu.append(cpu)
                rows[way].ratio.append(p99_ms[way] / p99_ms[WAYS[0]])
            said = json.dumps({way: round(value, 2) for way, value in p99_ms.items()})
            print(f"turn {turn + 1}: p99 in ms {said}, load {load_1min:.1f}", file=sys.stderr)
    n_turns = len(rows[WAYS[0]].figures)
    print(Table(COLUMNS, list(rows.values()) if n_turns else []).markdown())
    print(f"\nMedians of {n_turns} turns; {os.cpu_count()} cores.")
