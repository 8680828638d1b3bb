"""Asking Linux to run a node in time: what is permitted is applied, what is not is said.

Nothing here makes a run fail. Each option is explained in docs/realtime.md, with how to permit it.
"""

from __future__ import annotations

import ctypes
import os
import resource
from collections.abc import Collection
from pathlib import Path
from typing import NamedTuple

from rclpy.node import Node

from tel_ros.core.config import ControlConfig

_MCL_CURRENT, _MCL_FUTURE, _MCL_ONFAULT = 1, 2, 4  # <linux/mman.h>; not in Python's standard library
_CAP_IPC_LOCK = 14  # <linux/capability.h>
_TASKS = Path("/proc/self/task")
_STATUS = Path("/proc/self/status")


class OptionOutcome(NamedTuple):
    """What became of one option."""

    applied: bool
    text: str
    """What was applied; or what was refused, and how to permit it."""


def apply_realtime_options(node: Node, control: ControlConfig) -> None:
    """Apply the options to this process, when its node is complete, and log what became of them."""
    log = node.get_logger()
    for outcome in (set_priority(control.realtime_priority), lock_memory(control.lock_memory)):
        if outcome is not None:
            log.info(outcome.text) if outcome.applied else log.warning(outcome.text)


def set_priority(priority: int, but: Collection[int] = ()) -> OptionOutcome | None:
    """Give all threads of this process a SCHED_FIFO priority: those of the middleware deliver the messages.

    Later threads inherit it. ``but`` are native ids of threads that stay as they are. None: priority 0 asks
    for nothing.
    """
    if priority == 0:
        return None
    done = 0
    try:
        for task in _TASKS.iterdir():
            if int(task.name) in but:
                continue
            try:
                os.sched_setscheduler(int(task.name), os.SCHED_FIFO, os.sched_param(priority))
                done += 1
            except ProcessLookupError:
                continue  # a thread that has ended meanwhile
    except (OSError, AttributeError) as error:
        return OptionOutcome(
            False,
            f"control.realtime_priority = {priority} refused ({_reason(error)}): scheduled like any other "
            "program. Permit it with 'rtprio 98' in /etc/security/limits.conf or CAP_SYS_NICE "
            "(docs/realtime.md)",
        )
    return OptionOutcome(True, f"SCHED_FIFO priority {priority} for {done} threads")


def lock_memory(wanted: bool) -> OptionOutcome | None:
    """Keep all pages of this process, later ones too, from being swapped out; None: it is not wanted.

    Under a limit the call could succeed and a later request for memory fail, in the middle of a trial: then
    it is not asked for at all.
    """
    if not wanted:
        return None
    limit_bytes = resource.getrlimit(resource.RLIMIT_MEMLOCK)[1]
    if limit_bytes != resource.RLIM_INFINITY and not _has_capability(_CAP_IPC_LOCK):
        return _not_locked(f"at most {limit_bytes // 1024} kB may be locked")
    try:
        if limit_bytes == resource.RLIM_INFINITY:
            resource.setrlimit(resource.RLIMIT_MEMLOCK, (limit_bytes, limit_bytes))
        libc = ctypes.CDLL(None, use_errno=True)
        # On fault: what was reserved and is never used (thread stacks, mostly) takes no memory.
        if libc.mlockall(_MCL_CURRENT | _MCL_FUTURE | _MCL_ONFAULT) != 0:
            return _not_locked(os.strerror(ctypes.get_errno()))
    except (OSError, ValueError, AttributeError) as error:
        return _not_locked(_reason(error))
    return OptionOutcome(True, "memory is locked")


def _not_locked(reason: str) -> OptionOutcome:
    return OptionOutcome(
        False,
        f"control.lock_memory refused ({reason}): memory may be swapped out. Permit it with 'memlock "
        "unlimited' in /etc/security/limits.conf or CAP_IPC_LOCK (docs/realtime.md)",
    )


def _has_capability(number: int) -> bool:
    try:
        (line,) = [line for line in _STATUS.read_text().splitlines() if line.startswith("CapEff:")]
    except (OSError, ValueError):
        return False
    return bool(int(line.split()[1], 16) >> number & 1)


def _reason(error: Exception) -> str:
    return error.strerror if isinstance(error, OSError) and error.strerror else str(error)
