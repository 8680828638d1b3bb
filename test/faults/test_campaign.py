"""The fault campaign: faults are injected into the running graph, and none of them leads to a violation.

    python -m pytest test/faults --faults 500 --seed 1 --jobs 2

prints a line a fault and a table, and writes docs/faults.md. Results go to a file of JSON lines, one a fault;
the same command goes on where it was interrupted. Without ``--faults``, two faults are injected in lockstep.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from fault_campaign import campaign, line, run_apart, stored
from fault_page import table, write_page
from fault_plan import plan
from fault_setups import ROOT


@pytest.fixture(autouse=True)
def on_this_machine_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")


@pytest.mark.timeout(300)
def test_a_paused_and_an_interrupted_run_are_without_a_violation(
    tmp_path: Path, ros_domains: Iterator[int]
) -> None:
    faults = plan(2, 1, ["pause_trial_recorder", "interrupt"], ["lockstep"])
    faults.sort(key=lambda fault: fault.kind, reverse=True)
    domains = [next(ros_domains) for _ in range(3)]
    rows = run_apart(faults, tmp_path / "runs", domains, False, tmp_path / "results.jsonl")
    assert [(row.fault, row.violations) for row in rows] == [(fault, []) for fault in faults]
    assert sum(row.bags for row in rows) > 0
    assert stored(tmp_path / "results.jsonl", faults) == rows


@pytest.mark.timeout(0)
def test_no_fault_of_the_campaign_leads_to_a_violation(
    pytestconfig: pytest.Config, capsys: pytest.CaptureFixture[str]
) -> None:
    options = pytestconfig.option
    if not getattr(options, "faults", 0):
        pytest.skip("--faults asks for it")
    faults = plan(options.faults, options.seed, options.only, options.setup)
    work = options.work / f"seed_{options.seed}"
    work.mkdir(parents=True, exist_ok=True)
    results = work / "results.jsonl"
    done = {row.fault.index for row in stored(results, faults)}
    left = [fault for fault in faults if fault.index not in done and not options.stored]
    started, skipped = time.monotonic(), []
    runs = work / f"runs_{time.strftime('%Y%m%d-%H%M%S')}"
    with capsys.disabled():
        print()
        for row in campaign(left, options.jobs, options.domain, runs, options.keep, results):
            skipped += [row] if row.skipped else []
            print(line(row), flush=True)
        rows = sorted(stored(results, faults) + skipped, key=lambda row: row.fault.index)
        print(table(rows))
        print(f"{len(left)} faults in {(time.monotonic() - started) / 60.0:.1f} min; results: {results}")
    if options.page or not (options.only or options.setup):
        write_page(rows, options.page or ROOT / "docs" / "faults.md", _command(options), len(faults))
    assert [line(row) for row in rows if row.violations] == []


def _command(options: object) -> str:
    values = {name: getattr(options, name) for name in ("faults", "seed", "jobs", "only", "setup")}
    told = {name: " ".join(value) if isinstance(value, list) else value for name, value in values.items()}
    given = " ".join(f"--{name} {value}" for name, value in told.items() if value != "")
    return f"python -m pytest test/faults {given}"
