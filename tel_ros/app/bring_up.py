"""The nodes of a run as processes: starting them, watching them, and ending them in good order."""

from __future__ import annotations

import ctypes
import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import psutil

from tel_ros.app.errors import EXIT_BAD_INPUT, EXIT_GRAPH_FAILED, GraphError, Interrupted, Interruption
from tel_ros.core.config import Config
from tel_ros.local_stop import BRAKE_SIGNAL, ENDED
from tel_ros.nodes.preloaded import PRELOADED, order

MODULES = {
    "sim_bridge": "sim_bridge.node",
    "inverse_dynamics": "tel_ros.nodes.inverse_dynamics",
    "trial_recorder": "tel_ros.nodes.trial_recorder",
    "arm_guard": "tel_ros.nodes.arm_guard",
    "ep_controller": "tel_ros.nodes.ep_controller",
    "practice_manager": "tel_ros.nodes.practice_manager",
    "feedforward_controller": "tel_ros.nodes.serving.feedforward_controller",
}
"""The nodes in the order in which they start. They end in the opposite order: the arm last, and the guard
watches the controller to its end."""

_END_TIMEOUT_S = 8.0
_PR_SET_PDEATHSIG = 1
_LIBC = ctypes.CDLL(None)


ASKED = "practice_manager", "feedforward_controller"
"""Nodes that have the arm moved: for practice, and in service."""


def node_names(config: Config, asked: str = "practice_manager") -> list[str]:
    """Return the nodes that a run of this configuration starts; ``asked``: the one that moves the arm."""
    needed = {"sim_bridge": config.run.arm == "sim", "arm_guard": config.is_guarded}
    needed |= {name: name == asked for name in ASKED}
    return [name for name in MODULES if needed.get(name, True)]


def require_simulator() -> None:
    """Raise ModuleNotFoundError unless PyBullet is there, in which the simulated arm runs."""
    if find_spec("pybullet") is None:
        raise ModuleNotFoundError("the simulated arm needs it", name="pybullet")


@contextmanager
def preloading(names: Sequence[str]) -> Iterator[dict[str, subprocess.Popen[bytes]]]:
    """Have the processes of nodes import what they need, for :class:`NodeProcesses` to start them later.

    Those that nobody has taken by the end are killed: they have not begun to do anything.
    """
    processes = dict[str, "subprocess.Popen[bytes]"]()
    try:
        for name in names:
            processes[name] = _preload(name)
        yield processes
    finally:
        for process in processes.values():
            process.kill()
            process.communicate()


def _preload(name: str) -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        [sys.executable, "-m", MODULES[name], PRELOADED],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        start_new_session=True,  # Ctrl-C reaches the supervisor only, which ends the nodes in order
        preexec_fn=partial(die_with_parent, os.getpid()),
        env={**os.environ, "PYTHONUNBUFFERED": "1"},
    )


class NodeProcesses:
    """The processes of the graph, by names of :data:`MODULES`; use it with ``with``.

    They get SIGTERM from the kernel if this process dies, so that none outlives its supervisor. The
    controller hears of Ctrl-C at once, from a thread that the signal wakes up. ``resume``: whether to go on
    with the run in whose folder the configuration lies. ``waiting``:
    processes from :func:`preloading`; those that are started are taken out.
    """

    def __init__(
        self,
        config_file: Path,
        names: Sequence[str],
        log_folder: Path,
        *,
        resume: bool = False,
        namespace: str = "/",
        waiting: dict[str, subprocess.Popen[bytes]] | None = None,
    ) -> None:
        self._waiting = {} if waiting is None else waiting
        self._config_file, self._names, self._log_folder = config_file, names, log_folder
        # Whoever starts the nodes makes the report by themselves. A node's log has what rcl would write
        # into a file of its own, in a folder that need not be there.
        self._more = ["-r", f"__ns:={namespace}", "-p", "report:=false", "--disable-external-lib-logs"]
        self._more += ["-p", "resume:=true"] if resume else []
        self._processes: dict[str, subprocess.Popen[bytes]] = {}
        self._woken: tuple[socket.socket, socket.socket] | None = None

    def __enter__(self) -> NodeProcesses:
        """Start the nodes."""
        self._log_folder.mkdir(parents=True, exist_ok=True)
        if threading.current_thread() is threading.main_thread():
            ours, kernels = self._woken = socket.socketpair()
            kernels.setblocking(False)
            signal.set_wakeup_fd(kernels.fileno(), warn_on_full_buffer=False)
            threading.Thread(target=self._hear_signals, args=(ours,), daemon=True).start()
        try:
            for name in self._names:
                self._processes[name] = self._start(name)
            for process in self._processes.values():
                assert process.stdout is not None
                with process.stdout as ready:
                    ready.read(1)  # for as long as it takes: compiled code may have to be compiled first
        except BaseException:
            for process in self._processes.values():  # nothing has begun, and imports have no order
                process.kill()
            self.stop()
            raise
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, *_: object) -> None:
        """End the nodes; an error, or Ctrl-C, then tells what was seen meanwhile."""
        seen = self.stop()
        if isinstance(error, Interruption.errors()):
            raise Interrupted(seen) from None
        if isinstance(error, GraphError) and "ep_controller" in self._processes:
            raise GraphError(f"{error}; {seen}", error.exit_code) from None

    @property
    def pids(self) -> dict[str, int]:
        """Process numbers of the nodes."""
        return {name: process.pid for name, process in self._processes.items()}

    def check(self) -> None:
        """Raise GraphError if a node has ended; it says which, how, and what the node said last."""
        for name, process in self._processes.items():
            code = process.poll()
            if code is not None:
                how = f"was killed by {signal.Signals(-code).name}" if code < 0 else f"ended with code {code}"
                exit_code = EXIT_BAD_INPUT if code == EXIT_BAD_INPUT else EXIT_GRAPH_FAILED
                time.sleep(0.1)
                log = self._log_folder / f"{name}.log"
                lines = [line for line in log.read_text(errors="replace").splitlines() if line.strip()]
                said = f"; it said last: {lines[-1]} (log: {log})" if lines else f" (log: {log})"
                raise GraphError(f"node {name} {how}{said}", exit_code)

    def brake(self) -> None:
        """Have the controller brake before anything else happens, and the run end."""
        for name, number in (("ep_controller", BRAKE_SIGNAL), *((name, signal.SIGINT) for name in ASKED)):
            if process := self._processes.get(name):
                process.send_signal(number)

    def stop(self) -> str:
        """End all nodes, the controller before the arm so that it can brake it; return what was seen."""
        Interruption.held = True
        try:
            self.brake()
            killed = []
            for name in reversed(self._processes):
                if not end_process(self._processes[name], signal.SIGINT):
                    killed.append(name)
                if name == "ep_controller":  # what is not the arm need not wait for each other
                    for other in self._processes.keys() - {"sim_bridge"}:
                        self._processes[other].send_signal(signal.SIGINT)
        finally:
            Interruption.held = False
        if self._woken:
            signal.set_wakeup_fd(-1)
            self._woken[1].close()
            self._woken = None
        ended = f"{' and '.join(killed)} had to be killed" if killed else "all nodes have ended"
        return f"{self._seen_of_arm()}{ended}"

    def _hear_signals(self, woken: socket.socket) -> None:
        with woken:
            while number := woken.recv(1):
                if number[0] in Interruption.SIGNALS:
                    self.brake()

    def _seen_of_arm(self) -> str:
        if "ep_controller" not in self._processes:
            return ""
        said = (self._log_folder / "ep_controller.log").read_text(errors="replace")
        if not said:
            return "the controller had not started yet, "
        told = said.rpartition(ENDED)[2].strip() if ENDED in said else ""
        return f"{told or 'ep_controller has not told whether the arm is at rest'}, "

    def _start(self, name: str) -> subprocess.Popen[bytes]:
        # rcl reads parameter values as YAML; a JSON string is one, whatever the file is called.
        parameter = f"config:={json.dumps(str(self._config_file))}"
        arguments, log = ["--ros-args", "-p", parameter, *self._more], self._log_folder / f"{name}.log"
        log.write_bytes(b"")
        process = self._waiting.pop(name, None) or _preload(name)
        assert process.stdin is not None
        with suppress(BrokenPipeError), process.stdin as told:  # broken: it has ended, as check() will find
            told.write(order(arguments, log.absolute()))
        return process


def die_with_parent(parent: int) -> None:
    """Have the kernel send SIGTERM to this process when its parent dies; for ``preexec_fn``."""
    _LIBC.prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
    if os.getppid() != parent:  # it has died before
        os._exit(1)


def end_process(
    process: subprocess.Popen[Any], number: signal.Signals, timeout_s: float = _END_TIMEOUT_S
) -> bool:
    """Send a signal to a process, kill it and its children if it does not end; return whether it did."""
    if process.poll() is not None:
        return True
    process.send_signal(number)
    try:
        process.wait(timeout_s)
        return True
    except subprocess.TimeoutExpired:
        parent = psutil.Process(process.pid)
        for each in [*parent.children(recursive=True), parent]:
            with suppress(psutil.NoSuchProcess):
                each.kill()
        process.wait()
        return False
