"""What the fault campaign tells: its table, its page, and where an interrupted one goes on."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from fault_campaign import set_aside, stored
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
    (line,) = [line for line in text.splitlines() if line.startswith(kind)]
    return line.split()


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
    results.write_text("".join(row.as_json() + "\n" for row in done))
    assert stored(results, faults) == done
    assert stored(tmp_path / "nothing.jsonl", faults) == []


def test_results_of_another_campaign_are_not_taken_for_this_one(tmp_path: Path) -> None:
    results = tmp_path / "results.jsonl"
    results.write_text("".join(Row(fault).as_json() + "\n" for fault in plan(6, 1)))
    assert stored(results, plan(6, 2)) == []


def test_what_was_found_before_a_fault_was_injected_again_is_kept(tmp_path: Path, rows: list[Row]) -> None:
    results = tmp_path / "results.jsonl"
    faults = [row.fault for row in rows]

    def store(*violations: str) -> None:
        with results.open("a", encoding="utf-8") as file:
            file.write(replace(rows[0], violations=list(violations)).as_json() + "\n")

    results.write_text("".join(row.as_json() + "\n" for row in rows[1:3]), encoding="utf-8")
    for violation in ("first", "second"):
        store(violation)
        set_aside(results, [faults[0].index])
        assert faults[0] not in [row.fault for row in stored(results, faults)], "it is to be injected again"
    store()
    found = {row.fault.index: row for row in stored(results, faults)}
    assert [text.split()[0] for text in found[faults[0].index].earlier] == ["first", "second"]
    assert found[faults[0].index].violations == []
    assert found[faults[1].index] == rows[1]
