"""What the live view costs the control loop: the same trial without it, with it, and with somebody looking.

    .venv/bin/python benchmarks/view.py

A row is one trial of ``tel practice`` with ``sim.clock: realtime``, its figures those that the controller
wrote into the bag. The three ways take turns, because a shared machine is not equally busy all the time; the
ratio is to the trial without the view of the same turn. Looking: a client of the page that takes all that is
sent, as a browser does; what a browser needs to draw it is not in these figures (``--browser`` puts a
headless Chromium that draws in software in its place).
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import psutil
from realtime import Figures, product

ROOT = Path(__file__).parents[1]
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


async def take_everything(link: str) -> None:
    """Open the page's socket and take all that comes."""
    import viser
    from websockets.asyncio.client import connect

    origin, _, token = link.partition("/?token=")
    cookie = f"tel_view_{origin.rpartition(':')[2]}={token}"
    headers = {"Cookie": cookie}
    async with connect(
        origin.replace("http", "ws"),
        origin=origin,
        additional_headers=headers,
        subprotocols=[f"viser-v{viser.__version__}"],
        max_size=None,
    ) as socket:
        print("looks", flush=True)
        async for _ in socket:
            pass


@contextlib.contextmanager
def process(command: list[str]) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """Start a command, wait for its first line, and end it."""
    started = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    try:
        line = started.stdout.readline().strip()
        if not line:
            sys.exit(f"{command} ended with code {started.wait()}")
        yield started, line
    finally:
        started.terminate()
        started.wait()


def measure(way: str, options: argparse.Namespace, folder: Path) -> tuple[Figures | None, float]:
    """Return the figures of a trial, and the share of a core that the view used meanwhile."""
    with contextlib.ExitStack() as stack:
        view = None
        if way in WAYS[1:3]:
            command = [sys.executable, "-m", "tel_ros.app.cli", "view", str(options.config)]
            view, line = stack.enter_context(process(command))
            link = line.split()[-1]
        if way == WAYS[2]:
            looker = ["-c", _BROWSER] if options.browser else [__file__, "--look-at"]
            stack.enter_context(process([sys.executable, *looker, link]))
        before_s, began = _cpu_s(view), time.monotonic()
        figures = product(options.config, options.rate, options.seconds, 0, folder)
        return figures, (_cpu_s(view) - before_s) / (time.monotonic() - began)


def _cpu_s(view: subprocess.Popen[str] | None) -> float:
    if view is None:
        return 0.0
    used = psutil.Process(view.pid).cpu_times()
    return used.user + used.system


def main() -> None:
    """Measure, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--config", type=Path, default=ROOT / "config" / "paper.yaml")
    parser.add_argument("--rate", type=float, default=500.0, metavar="HZ")
    parser.add_argument("--seconds", type=float, default=10.0, help="of movement in each trial")
    parser.add_argument("--turns", type=int, default=5)
    parser.add_argument("--browser", action="store_true", help="looked at with a headless Chromium")
    parser.add_argument("--look-at", metavar="LINK", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.look_at:
        asyncio.run(take_everything(options.look_at))
        return
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    found: dict[str, list[tuple[Figures, float, float]]] = {way: [] for way in WAYS}
    with tempfile.TemporaryDirectory() as folder:
        for turn in range(options.turns):
            load_1min = os.getloadavg()[0]
            measured = {way: measure(way, options, Path(folder) / f"{turn}_{way}") for way in WAYS}
            if any(figures is None for figures, _ in measured.values()):
                print(f"turn {turn + 1}: a run failed; left out", file=sys.stderr)
                continue
            alone = measured[WAYS[0]][0].jitter_p99_ms
            for way, (figures, cpu) in measured.items():
                found[way].append((figures, cpu, figures.jitter_p99_ms / alone))
            ours = {way: round(figures.jitter_p99_ms, 2) for way, (figures, _) in measured.items()}
            print(f"turn {turn + 1}: p99 in ms {json.dumps(ours)}, load {load_1min:.1f}", file=sys.stderr)
    print(table(found))


def table(found: dict[str, list[tuple[Figures, float, float]]]) -> str:
    """Return the medians over the turns as a Markdown table."""
    lines = [
        "| | rate Hz | jitter p50 ms | p99 ms (range) | answered in time % | p99, times that without "
        "| view, % of a core |",
        "|---|---|---|---|---|---|---|",
    ]
    for way, turns in found.items():
        if not turns:
            continue
        p99 = [figures.jitter_p99_ms for figures, _, _ in turns]

        def middle(name: str, turns: list = turns) -> float:
            return statistics.median(getattr(figures, name) for figures, _, _ in turns)

        lines.append(
            f"| {way} | {middle('rate_hz'):.0f} | {middle('jitter_p50_ms'):.3f} "
            f"| {statistics.median(p99):.2f} ({min(p99):.2f}–{max(p99):.2f}) "
            f"| {middle('in_time_percent'):.1f} | {statistics.median(r for _, _, r in turns):.2f} "
            f"| {100.0 * statistics.median(cpu for _, cpu, _ in turns):.0f} |"
        )
    turns = len(next(iter(found.values())))
    return "\n".join([*lines, "", f"Medians of {turns} turns; {os.cpu_count()} cores."])


if __name__ == "__main__":
    main()
