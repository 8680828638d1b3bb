"""What a C++ library prints does not reach a program's output."""

from __future__ import annotations

import os
import subprocess
import sys

SCRIPT = """
import ctypes
from sim_bridge.quiet import stdout_to_stderr

print("before")
with stdout_to_stderr():
    ctypes.CDLL(None).printf(b"from C")
print("after")
"""


def test_only_what_is_printed_from_c_meanwhile_goes_to_standard_error() -> None:
    """C keeps what it prints in a buffer of its own; it must not come out after the switch back."""
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT],
        # With PYTHONUNBUFFERED Python switches C's buffer off, and there would be nothing to test.
        env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path), "PYTHONUNBUFFERED": ""},
        capture_output=True,
        text=True,
        timeout=50,
        check=True,
    )
    assert done.stdout.split() == ["before", "after"]
    assert done.stderr.endswith("from C")
