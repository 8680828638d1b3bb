"""Processes of nodes that import while nobody has told them yet what to do."""

from __future__ import annotations

import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import psutil

from tel_ros.app.bring_up import preloading
from tel_ros.nodes.preloaded import PRELOADED, order

ROOT = Path(__file__).parents[2]

NODE = """
import sys
from tel_ros.nodes.preloaded import take_order

take_order()
print("as", *sys.argv[1:], repr(sys.stdin.read()))
print("words of a library", file=sys.stderr)
"""


def node(arguments: list[str], told: bytes = b"") -> str:
    command = [sys.executable, "-c", NODE, *arguments]
    return subprocess.run(command, input=told, cwd=ROOT, capture_output=True, check=True).stdout.decode()


def test_a_preloaded_node_runs_as_it_is_told_and_writes_to_its_log(tmp_path: Path) -> None:
    log = tmp_path / "node.log"
    assert node([PRELOADED], order(["-p", "a b"], log)) == "\n"
    assert log.read_text() == "as -p a b ''\nwords of a library\n"
    assert node(["-p", "a b"], b"input") == "as -p a b 'input'\n"


def test_a_preloaded_node_that_nobody_needs_ends_without_a_word() -> None:
    assert node([PRELOADED]) == "\n"
    with preloading(["arm_guard", "ep_controller"]) as waiting:
        processes = list(waiting.values())
        assert all(process.poll() is None for process in processes)
    assert [process.returncode for process in processes] == [-signal.SIGKILL] * 2


def test_a_child_goes_with_its_parent_even_if_that_has_died_before_it_could_ask_for_it(
    tmp_path: Path,
) -> None:
    script = """
        import os, subprocess, sys, time
        from functools import partial
        from tel_ros.app.bring_up import die_with_parent
        parent = int(sys.argv[1]) or os.getpid()
        child = subprocess.Popen(["sleep", "60"], preexec_fn=partial(die_with_parent, parent))
        print(child.pid, flush=True)
        time.sleep(60)
    """
    for parent in (0, 1):
        command = [sys.executable, "-c", textwrap.dedent(script), str(parent)]
        with subprocess.Popen(command, stdout=subprocess.PIPE, cwd=ROOT) as process:
            assert process.stdout is not None
            pid = int(process.stdout.readline())
            if not parent:
                assert psutil.Process(pid).name() == "sleep"
                process.kill()
            end = time.monotonic() + 20.0
            while psutil.pid_exists(pid) and psutil.Process(pid).status() != psutil.STATUS_ZOMBIE:
                assert time.monotonic() < end
                time.sleep(0.02)
            process.kill()
