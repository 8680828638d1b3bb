"""A graph of real processes to inject faults into: ``tel practice``, the arm, and the campaign's observer."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack, suppress
from pathlib import Path

import psutil
from fault_setups import ROOT, Setup
from fault_tap import REMAPPED, spun_tap

from tel_ros.core.config import Config
from tel_ros.recording.run_folder import CONFIG_FILE, LOG_FOLDER, create_run_folder

DISK_MB = 24
START_TIMEOUT_S = 120.0
END_TIMEOUT_S = 75.0
"""Longer than the practice manager waits for an answer, and bring-up for the nodes' end."""
_GOODBYE_S = 12.0


class DiskUnavailableError(Exception):
    """This machine does not let us mount a small disk."""


class FaultGraph:
    """``tel practice`` in a process of its own, with its nodes; use it with ``with``.

    The folder, for everything that is written, must not exist.

    Raises:
        DiskUnavailableError: there is to be a small disk, and it cannot be mounted.
    """

    def __init__(self, setup: Setup, folder: Path, domain: int, trials: int, small_disk: bool) -> None:
        self.setup, self._folder, self._domain, self._small_disk = setup, folder, domain, small_disk
        folder.mkdir(parents=True)
        self.config: Config
        self.config, self._settings = setup.config(folder, trials)
        self._disk = folder / "disk"
        self.run = (self._disk if small_disk else folder) / "run"
        self._timers: list[threading.Timer] = []

    def __enter__(self) -> FaultGraph:
        with ExitStack() as self._stack:
            self._start()
            self._stack = self._stack.pop_all()
        return self

    def __exit__(self, *error: object) -> None:
        for timer in self._timers:
            timer.cancel()
        self._stack.close()

    def _start(self) -> None:
        if self._small_disk:
            self._mount()
        self._environment = {
            **os.environ,
            "ROS_DOMAIN_ID": str(self._domain),
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
            "PYTHONUNBUFFERED": "1",
            **{f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "MKL", "NUMBA")},
        }
        self._arm: subprocess.Popen[bytes] | None = None
        if self.setup.in_between:
            create_run_folder(self._folder / "arm", self.config)
            parameter = f"config:={self._folder / 'arm' / CONFIG_FILE}"
            self._arm = self._spawn(
                ["-m", "sim_bridge.node", "--ros-args", "-p", parameter, *REMAPPED], "arm"
            )
        self.tap = self._stack.enter_context(
            spun_tap(self._domain, self.setup.in_between, self.config.control.realtime_priority)
        )
        arguments = ["-m", "tel_ros.app.cli", "practice", str(self.setup.config_file)]
        arguments += ["--out", str(self.run), "--no-report", "--json"]
        for setting in self._settings:
            arguments += ["--set", setting]
        self.tel = self._spawn(arguments, "tel")
        self._nodes: dict[str, psutil.Process] = {}

    def _spawn(self, arguments: list[str], name: str) -> subprocess.Popen[bytes]:
        out, err = ((self._folder / f"{name}.{end}").open("wb") for end in ("out", "err"))
        with out, err:
            process = subprocess.Popen(
                # Whatever ends the campaign ends the graph as well.
                ["setpriv", "--pdeathsig", "TERM", sys.executable, *arguments],
                **{"stdout": out, "stderr": err, "stdin": subprocess.DEVNULL},
                **{"cwd": ROOT, "env": self._environment},
            )
        self._stack.callback(_end, process, self.nodes if name == "tel" else dict)
        return process

    def _mount(self) -> None:
        self._disk.mkdir()
        command = ["mount", "-t", "tmpfs", "-o", f"size={DISK_MB}m", "tmpfs", str(self._disk)]
        mounted = subprocess.run(command, capture_output=True, text=True, check=False)
        if mounted.returncode:
            raise DiskUnavailableError(mounted.stderr.strip())
        self._stack.callback(subprocess.run, ["umount", "--lazy", str(self._disk)], check=False)

    def nodes(self) -> dict[str, psutil.Process]:
        """Return the processes by name: nodes that were seen so far, ``tel``, and ``sim_bridge``."""
        if self.tel.poll() is None:
            for child in psutil.Process(self.tel.pid).children():
                try:
                    name = _node_of(child.cmdline())
                except psutil.NoSuchProcess:
                    continue
                if name:
                    self._nodes[name] = child
            self._nodes["tel"] = psutil.Process(self.tel.pid)
        if self._arm is not None and self._arm.poll() is None:
            self._nodes["sim_bridge"] = psutil.Process(self._arm.pid)
        return self._nodes

    def pause(self, name: str, pause_s: float) -> None:
        process = self._nodes[name]
        process.send_signal(signal.SIGSTOP)
        self.later(pause_s, lambda: process.send_signal(signal.SIGCONT))

    def later(self, wait_s: float, act: Callable[[], None]) -> None:
        """Do something to a process after a time of the wall clock, if it is still there."""

        def act_if_there() -> None:
            with suppress(psutil.NoSuchProcess):
                act()

        self._timers.append(threading.Timer(wait_s, act_if_there))
        self._timers[-1].start()

    def send(self, name: str, number: signal.Signals) -> None:
        self._nodes[name].send_signal(number)

    def fill_disk(self) -> None:
        """Begin to leave no free block on the run's disk."""

        def fill() -> None:
            # Without a buffer: what is left in it could not be written when the file is closed.
            with (
                tempfile.NamedTemporaryFile(dir=self._disk, delete=False, buffering=0) as file,
                suppress(OSError),
            ):
                while True:
                    file.write(bytes(1 << 16))

        threading.Thread(target=fill).start()

    def limit_files(self, name: str) -> None:
        self._nodes[name].rlimit(psutil.RLIMIT_FSIZE, (0, 0))

    def ended(self) -> bool:
        return self.tel.poll() is not None

    def wait(self, condition: Callable[[], bool], timeout_s: float) -> bool:
        """Wait for a condition; return whether it came."""
        end = time.monotonic() + timeout_s
        while not condition():
            if time.monotonic() > end:
                return False
            time.sleep(0.02)
        return True

    def left_behind(self) -> list[str]:
        """Return the nodes that outlive the run, after a time for saying goodbye."""
        ours = {
            name: process for name, process in self._nodes.items() if name != "sim_bridge" or not self._arm
        }
        self.wait(lambda: not any(map(_runs, ours.values())), _GOODBYE_S)
        return sorted(name for name, process in ours.items() if _runs(process))

    def last_words(self) -> str:
        text = (self._folder / "tel.err").read_text(errors="replace")
        lines = [line for line in text.splitlines() if line.strip()]
        said = [line for line in lines if line.startswith("tel: ")]
        return (said or lines or [""])[-1]

    def log(self, name: str) -> str:
        file = self._folder / "tel.err" if name == "tel" else self.run / LOG_FOLDER / f"{name}.log"
        return file.read_text(errors="replace") if file.exists() else ""


def _node_of(command: list[str]) -> str | None:
    """Return the name of the node that a command line starts."""
    modules = [part for part in command if re.fullmatch(r"(sim_bridge|tel_ros\.nodes)\.\w+", part)]
    if not modules:
        return None
    return "sim_bridge" if modules[0].startswith("sim_bridge") else modules[0].rsplit(".", 1)[-1]


def _runs(process: psutil.Process) -> bool:
    try:
        return process.is_running() and process.status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False


def _end(process: subprocess.Popen[bytes], children: Callable[[], dict[str, psutil.Process]]) -> None:
    """End a process and whatever is left of those it has started."""
    if process.poll() is None:
        process.send_signal(signal.SIGINT)
        try:
            process.wait(_GOODBYE_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
    for child in children().values():
        if _runs(child):
            child.kill()
