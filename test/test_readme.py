"""The README's example of reading a trial runs as it stands."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]


def test_the_example_of_reading_a_trial_prints_duration_and_error() -> None:
    (example,) = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), flags=re.DOTALL)
    run = subprocess.run(
        [sys.executable, "-c", example], cwd=ROOT, capture_output=True, text=True, timeout=50, check=True
    )
    duration_s, error_rad = (float(word) for word in run.stdout.split())
    assert duration_s == 3.5
    assert 0.25 < error_rad < 0.35  # an untrained arm at that speed
