"""A node as a process: what ends it, and that neither a clock nor the middleware keeps it from ending."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from rclpy.context import Context
from tel_process import HANG_S, PAPER, wait_until

from tel_ros.core.errors import TelError
from tel_ros.nodes.runner import start_ros

Start = Callable[..., subprocess.Popen[str]]
MODULES = (
    "sim_bridge.node",
    *(
        f"tel_ros.nodes.{name}"
        for name in ("ep_controller", "arm_guard", "inverse_dynamics", "practice_manager", "trial_recorder")
    ),
)
STUCK = """
import ctypes, rclpy
rclpy.try_shutdown = lambda: ctypes.PyDLL(None).sleep(1000)  # holds the interpreter, as Fast DDS does
from tel_ros.nodes.arm_guard import main
main()
"""

UNDER_NOHUP = """
import signal
signal.signal(signal.SIGHUP, signal.SIG_IGN)
from tel_ros.nodes.arm_guard import main
main()
"""

PARTS = """
import os, signal, threading
from pathlib import Path
from tel_ros.nodes.ep_controller import main
threading.Timer(2.0, os.kill, (os.getpid(), signal.SIGTERM)).start()
main()
print(*(name.read_text() for name in Path("/proc/self/task").glob("*/comm")))
"""


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Start]:
    """Return a function that starts a node as ``ros2 run`` does; its log is a file of its name."""
    running: list[subprocess.Popen[str]] = []

    def begin(*command: str, name: str, arguments: tuple[str, ...] = ()) -> subprocess.Popen[str]:
        given = ["--ros-args", "-p", f"config:={PAPER}", *arguments]
        with (tmp_path / name).open("w") as log:
            running.append(
                subprocess.Popen([sys.executable, *command, *given], stderr=log, text=True, cwd=tmp_path)
            )
        return running[-1]

    yield begin
    for process in running:
        process.kill()
        process.wait(HANG_S)


def test_without_the_clock_that_they_are_to_go_by_all_nodes_say_so_and_end_on_a_signal(
    start: Start, tmp_path: Path
) -> None:
    sim_time = ("-p", "use_sim_time:=true")
    nodes = {module: start("-m", module, name=module, arguments=sim_time) for module in MODULES}
    missing = "use_sim_time is true and nobody publishes /clock"
    for module in nodes:
        log = tmp_path / module
        wait_until(lambda log=log: missing in log.read_text(), module)
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    for k, (module, process) in enumerate(nodes.items()):  # in turn: each has its time for it
        process.send_signal(numbers[k % 3])
        assert process.wait(HANG_S) == 0, (module, (tmp_path / module).read_text())
    assert "ended: the controller has not moved the arm" in (tmp_path / MODULES[1]).read_text()


def test_a_node_that_the_middleware_does_not_let_go_ends_all_the_same(start: Start, tmp_path: Path) -> None:
    process = start("-c", STUCK, name="stuck")
    wait_until(lambda: "nothing to guard" in (tmp_path / "stuck").read_text(), "the guard")
    time.sleep(0.5)
    process.send_signal(signal.SIGTERM)
    for _ in range(3):  # asking again is nothing that ends it: the arm may still be moving
        time.sleep(0.1)
        process.send_signal(signal.SIGINT)
    assert process.wait(HANG_S) == -signal.SIGALRM


def test_a_node_under_nohup_outlives_its_terminal(start: Start, tmp_path: Path) -> None:
    process = start("-c", UNDER_NOHUP, name="guard")
    wait_until(lambda: "nothing to guard" in (tmp_path / "guard").read_text(), "the guard")
    process.send_signal(signal.SIGHUP)
    with pytest.raises(subprocess.TimeoutExpired):
        process.wait(1.0)
    process.send_signal(signal.SIGTERM)
    assert process.wait(HANG_S) == 0


def test_the_participant_is_gone_when_a_node_has_ended(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", PARTS], cwd=tmp_path, capture_output=True, text=True, timeout=HANG_S
    )
    assert done.returncode == 0 and "python" in done.stdout
    assert "dds.ev" not in done.stdout  # its thread


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (("--ros-args", "-p", "foo"), "'-p foo'"),
        (("--ros-args", "-p", "control.rate_hz:=[1, foo"), "'-p control.rate_hz:=[1, foo'"),
        (("--ros-args", "--params-file", "nowhere.yaml"), "nowhere.yaml: there is no such file"),
        (("--ros-args", "--params-file", "text.yaml"), "text.yaml: holds 'only words'"),
        (("--ros-args", "--nonsense"), "--nonsense"),
        (("-p", "control.rate_hz:=500.0"), "'-p control.rate_hz:=500.0' is no argument"),
    ],
)
def test_malformed_arguments_are_refused_by_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: tuple[str, ...], named: str
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("text.yaml").write_text("only words")
    context = Context()
    with pytest.raises(TelError, match=re.escape(named)):
        start_ros(["arm_guard", *arguments], context)
    assert not context.ok()


@pytest.mark.parametrize(("value", "named"), [("foo", "'-p foo'"), ("use_sim_time:=often", "use_sim_time")])
def test_malformed_arguments_end_in_one_line_and_code_2(tmp_path: Path, value: str, named: str) -> None:
    command = [sys.executable, "-m", "tel_ros.nodes.arm_guard", "--ros-args", "-p", value]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=HANG_S)
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert named in line
