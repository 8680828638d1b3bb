"""What is asked of the operating system, and that a refusal is said and does no harm."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from tel_ros.nodes import realtime

KEEPS_ITS_PROMISE = """
import os, threading
from tel_ros.nodes.realtime import lock_memory, set_priority
ends = threading.Event()
threading.Thread(target=ends.wait).start()
outcomes = set_priority(7), lock_memory(True)
tasks = [int(task) for task in os.listdir("/proc/self/task")]
found = [(os.sched_getscheduler(task), os.sched_getparam(task).sched_priority) for task in tasks]
raised = [each == (os.SCHED_FIFO, 7) for each in found]
locked = [line.split()[1] for line in open("/proc/self/status") if line.startswith("VmLck:")]
ends.set()
assert len(tasks) >= 2
assert all(raised) if outcomes[0].applied else not any(raised), (outcomes, raised)
assert (locked != ["0"]) == outcomes[1].applied, (outcomes, locked)
held = bytearray(64 * 1024 * 1024)  # memory can still be had
print(*(outcome.text for outcome in outcomes), sep="\\n")
"""


def test_what_is_said_to_be_applied_is_applied_and_a_process_works_on_in_any_case() -> None:
    """In a process of its own, with whatever this machine permits."""
    done = subprocess.run(
        [sys.executable, "-c", KEEPS_ITS_PROMISE], capture_output=True, text=True, timeout=50
    )
    assert done.returncode == 0, done.stderr
    priority, memory = done.stdout.splitlines()
    assert priority.startswith(("SCHED_FIFO priority 7 for", "control.realtime_priority = 7 refused"))
    assert memory.startswith(("memory is locked", "control.lock_memory refused"))


def test_nothing_is_asked_for_by_default(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_setscheduler", lambda *args: pytest.fail("asked for a priority"))
    monkeypatch.setattr(realtime.ctypes, "CDLL", lambda *args, **kwargs: pytest.fail("asked for memory"))
    assert realtime.set_priority(0) is None
    assert realtime.lock_memory(False) is None


def test_threads_that_are_to_stay_as_they_are_do(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[int] = []
    monkeypatch.setattr(os, "sched_setscheduler", lambda thread, *args: asked.append(thread))
    monkeypatch.setattr(realtime, "_TASKS", _Tasks([11, 12, 13]))
    realtime.set_priority(42, but=[12])
    assert asked == [11, 13]


def test_every_thread_gets_the_priority(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[int, int, int]] = []

    def set_scheduler(thread: int, policy: int, parameters: os.sched_param) -> None:
        if not asked:
            asked.append((0, 0, 0))
            raise ProcessLookupError  # one of them ends at that moment
        asked.append((thread, policy, parameters.sched_priority))

    monkeypatch.setattr(os, "sched_setscheduler", set_scheduler)
    monkeypatch.setattr(realtime, "_TASKS", fake := _Tasks([11, 12, 13]))
    outcome = realtime.set_priority(42)
    assert asked[1:] == [(thread, os.SCHED_FIFO, 42) for thread in fake.threads[1:]]
    assert outcome == realtime.OptionOutcome(True, "SCHED_FIFO priority 42 for 2 threads")


def test_a_refused_priority_says_why_and_how_to_permit_it(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*args: object) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    outcome = realtime.set_priority(42)
    assert outcome is not None
    assert not outcome.applied
    assert "control.realtime_priority = 42 refused (Operation not permitted)" in outcome.text
    assert "rtprio" in outcome.text and "CAP_SYS_NICE" in outcome.text


def test_memory_is_not_locked_under_a_limit_that_a_later_request_could_meet(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(resource, "getrlimit", lambda kind: (8 << 20, 8 << 20))
    monkeypatch.setattr(realtime.ctypes, "CDLL", lambda *args, **kwargs: pytest.fail("asked for memory"))
    (tmp_path / "status").write_text("Name:\tpython\nCapEff:\t00000000a80425fb\n")  # as in a container
    monkeypatch.setattr(realtime, "_STATUS", tmp_path / "status")
    outcome = realtime.lock_memory(True)
    assert outcome is not None
    assert not outcome.applied
    assert "refused (at most 8192 kB may be locked)" in outcome.text
    assert "memlock unlimited" in outcome.text and "CAP_IPC_LOCK" in outcome.text


def test_this_process_is_left_as_it_was() -> None:
    """The tests above must not change the scheduling of those that follow."""
    assert os.sched_getscheduler(threading.get_native_id()) == os.SCHED_OTHER


class _Tasks:
    def __init__(self, threads: list[int]) -> None:
        self.threads = threads

    def iterdir(self) -> list[Path]:
        return [Path("/proc/self/task") / str(thread) for thread in self.threads]
