"""What the fault campaign tells: its table, its page, and where an interrupted one goes on."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import pytest
from fault_campaign import stored
from fault_injection import Row
from fault_page import table, write_page
from fault_plan import Fault, plan


@pytest.fixture
def rows() -> list[Row]:
    """Return results of five faults, one of them with a violation and one that was skipped."""
    faults = [
        Fault(1, "state_nan", "planar", 0.5, {"duration_s": 1.0, "joint": 0}),
        Fault(2, "state_nan", "planar", 0.7, {"duration_s": 0.004, "joint": 1}),
        Fault(3, "kill_tel", "lockstep", 0.1),
        Fault(4, "disk_full", "planar", 0.1),
        Fault(5, "state_silence", "iiwa", 0.2, {"duration_s": 1.0}),
    ]
    return [
        Row(faults[0], outcome="aborted", reaction_s=0.02, stopped="held", bags=2),
        Row(faults[1], outcome="completed", bags=1),
        Row(faults[2], outcome="cancelled", reaction_s=0.01, stopped="held"),
        Row(faults[3], skipped="no small disk can be mounted here: not permitted"),
        Row(
            faults[4],
            violations=["speed of 1.200 of the limit (/tmp/some/where/log)"],
            earlier=["the trial was not completed (stall of 0.2 s)"],
            reaction_s=0.3,
            stopped="held",
            speed_share=1.2,
        ),
    ]


def line_of(text: str, kind: str) -> list[str]:
    (line,) = [line for line in text.splitlines() if line.startswith(f"| {kind}")]
    return line.replace("|", "").split()


def test_the_table_counts_faults_violations_and_ways_of_stopping(rows: list[Row]) -> None:
    text = table(rows)
    assert line_of(text, "state_nan")[1:4] == ["2", "0", "1"]
    assert line_of(text, "state_silence")[1:3] == ["1", "1"]
    assert "300 / 300" in " ".join(line_of(text, "state_silence"))
    assert line_of(text, "all")[1:5] == ["5", "(1", "skipped)", "1"]


def test_the_page_tells_violations_skipped_and_repeated_faults(rows: list[Row], tmp_path: Path) -> None:
    write_page(rows, tmp_path / "faults.md", "pytest test/faults --faults 9", 9)
    page = (tmp_path / "faults.md").read_text()
    assert "So far 5 of 9." in page
    assert "4 faults were injected" in page
    assert "1 of them led to a violation" in page
    assert "1 were skipped: no small disk can be mounted here: not permitted" in page
    assert "speed of 1.200 of the limit" in page
    assert "stall of 0.2 s" in page
    assert "/tmp/some" not in page


def test_an_interrupted_campaign_goes_on_with_the_faults_that_are_not_stored(tmp_path: Path) -> None:
    faults, results = plan(6, 1), tmp_path / "results.jsonl"
    done = [Row(fault, outcome="completed", reaction_s=0.1) for fault in faults[:4]]
    results.write_text("".join(json.dumps(asdict(row)) + "\n" for row in done))
    assert stored(results, faults) == done
    assert stored(tmp_path / "nothing.jsonl", faults) == []
    assert stored(results, plan(6, 2)) == [], "those of another campaign"
