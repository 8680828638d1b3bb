"""Nodes that import everything before they are told what to do: ``python -m tel_ros.nodes.NODE --preloaded``.

Imports take most of the time from the command to the first effort. They need no configuration, so they go on
while ``tel`` still checks and looks for another graph. Such a process says on stdout when it is ready. Before
its order comes (a line of JSON on stdin) it does nothing in ROS; where none comes it ends.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

PRELOADED = "--preloaded"


def order(arguments: Sequence[str], log: Path) -> bytes:
    """Return the line that has a preloaded node run with these arguments, writing to a log."""
    return json.dumps({"arguments": list(arguments), "log": str(log)}).encode() + b"\n"


def take_order() -> None:
    """Wait for the order, if this process is to, and go on as if it had been started like that."""
    if sys.argv[1:] != [PRELOADED]:
        return
    with suppress(OSError):  # nobody is there any more: then there will be no order
        os.write(1, b"\n")
    line = sys.stdin.readline()
    if not line:
        sys.exit()
    ordered = json.loads(line)
    sys.argv[1:] = ordered["arguments"]
    with open(os.devnull) as nothing, open(ordered["log"], "a", encoding="utf-8") as log:
        for file, descriptor in ((nothing, 0), (log, 1), (log, 2)):
            os.dup2(file.fileno(), descriptor)
