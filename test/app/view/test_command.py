"""The command line of the live view, where its extra is not installed."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[3]


def test_without_its_extra_the_view_is_one_clear_line() -> None:
    without = "import sys; sys.modules['viser'] = None\nfrom tel_ros.app.cli import main\nmain()"
    for arguments in (["view", "config/paper.yaml"], ["practice", "config/paper.yaml", "--view"]):
        done = subprocess.run(
            [sys.executable, "-c", without, *arguments], cwd=ROOT, capture_output=True, text=True, timeout=120
        )
        assert done.returncode == 2
        assert done.stderr == "tel: the live view needs viser: pip install 'tel_ros[view]'\n"
