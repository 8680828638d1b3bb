"""The README's example of reading a trial runs as it stands."""

from __future__ import annotations

import pytest
from code_blocks import ROOT, blocks_of, run_text


@pytest.mark.timeout(300)  # on a machine that stands still most of the time
def test_the_example_of_reading_a_trial_prints_duration_and_error() -> None:
    (example,) = [block for block in blocks_of(ROOT / "README.md") if block["language"] == "python"]
    run = run_text("python", example["source"], ROOT, timeout_s=250)
    assert run.returncode == 0, run.stderr
    duration_s, error_rad = (float(word) for word in run.stdout.split())
    assert duration_s == 3.5
    assert 0.25 < error_rad < 0.35  # an untrained arm at that speed
