"""The fault campaign: faults injected into the real graph, each of them judged.

    .venv/bin/python benchmarks/faults.py --faults 500 --seed 1 --jobs 2

Prints a line a fault and the table, and writes docs/faults.md. Results go to a file of JSON lines, one a
fault; the same command goes on where it was interrupted. Exit code 1 if any fault led to a violation.
"""

from __future__ import annotations

import argparse
import itertools
import json
import multiprocessing
import os
import sys
import time
from collections.abc import Collection, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import asdict
from pathlib import Path

from fault_campaign import Row, run_batch
from fault_kinds import KINDS
from fault_page import table, write_page
from fault_plan import Fault, batches, plan
from fault_setups import SETUPS

ROOT = Path(__file__).parents[1]
PROCESSES = 3
"""So many a batch may use up."""
SUPERSEDED = "superseded.jsonl"
"""Beside the results: those of faults that were injected again when asked to."""
DOMAINS_PER_JOB = 20
"""A graph gets another domain than the one before it: what that has left behind must not answer."""


def stored(results: Path, faults: Sequence[Fault]) -> list[Row]:
    """Return the rows of these very faults that are in the file already, with what was found before."""
    rows = {row.fault.index: row for row in _read(results, faults)}
    for before in reversed(_read(results.with_name(SUPERSEDED), faults)):
        row = rows.get(before.fault.index)
        if row is not None and before.violations:
            row.earlier.insert(0, f"{'; '.join(before.violations)} (injected again when asked to)")
    return list(rows.values())


def _read(results: Path, faults: Sequence[Fault]) -> list[Row]:
    if not results.exists():
        return []
    wanted = {fault.index: asdict(fault) for fault in faults}
    rows = []
    for line in results.read_text(encoding="utf-8").splitlines():
        values = json.loads(line)
        fault = values.pop("fault")
        if wanted.get(fault["index"]) == fault:
            rows.append(Row(Fault(**fault), **values))
    return rows


def set_aside(results: Path, again: Collection[int]) -> None:
    """Move the results of some faults to another file, so that they are injected again."""
    lines = results.read_text(encoding="utf-8").splitlines(keepends=True)
    aside = [line for line in lines if json.loads(line)["fault"]["index"] in again]
    with results.with_name(SUPERSEDED).open("a", encoding="utf-8") as file:
        file.writelines(aside)
    rest = results.with_suffix(".rest")
    rest.write_text("".join(line for line in lines if line not in aside), encoding="utf-8")
    rest.replace(results)


def run_apart(
    part: Sequence[Fault], folder: Path, domains: Sequence[int], keep: bool, results: Path
) -> list[Row]:
    """Run a batch in a process of its own.

    The middleware has been seen to take that process down with a graph. That costs no other batch anything,
    and what is left of this one is gone on with on another domain.

    Raises:
        BrokenProcessPool: it happens again and again.
    """
    for attempt in itertools.count():
        done = stored(results, part)
        indices = {row.fault.index for row in done}
        left = [fault for fault in part if fault.index not in indices]
        moved_on = [*domains[attempt:], *domains[:attempt]]
        with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
            future = pool.submit(run_batch, left, folder / f"process_{attempt + 1}", moved_on, keep, results)
            try:
                return done + future.result()
            except BrokenProcessPool:
                if attempt == PROCESSES - 1:
                    raise
                print(f"the process of {folder.name} has died; another goes on", file=sys.stderr, flush=True)


def campaign(
    faults: Sequence[Fault], jobs: int, domain: int, work: Path, keep: bool, results: Path
) -> Iterator[Row]:
    """Inject the faults, and give their rows as they come."""
    done_alone = [fault for fault in faults if SETUPS[fault.setup].alone]
    side_by_side = [fault for fault in faults if not SETUPS[fault.setup].alone]
    for some, n_jobs in ((side_by_side, jobs), (done_alone, 1)):
        with ThreadPoolExecutor(n_jobs) as pool:
            futures = []
            for k, part in enumerate(batches(some)):
                # Neighbours in the list run at the same time.
                first = domain + (k % (2 * n_jobs)) * (DOMAINS_PER_JOB // 2)
                domains = range(first, first + DOMAINS_PER_JOB // 2)
                folder = work / f"batch_{part[0].index:04d}"
                futures.append(pool.submit(run_apart, part, folder, domains, keep, results))
            for future in as_completed(futures):
                yield from future.result()


def line(row: Row) -> str:
    """Return one line about a fault."""
    fault = row.fault
    verdict = f"SKIPPED {row.skipped}" if row.skipped else "; ".join(row.violations) or "ok"
    reaction = "" if row.reaction_s is None else f"{1e3 * row.reaction_s:.0f} ms"
    return (
        f"{fault.index:4d}  {fault.kind:24s} {fault.setup:9s} {fault.offset_s:5.2f} s  {row.outcome:10s} "
        f"{reaction:>7s} {row.stopped:5s} {row.wall_s:5.1f} s  {verdict}  [{row.message}]"
    )


def main() -> None:
    """Run the campaign, print its table, write the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--faults", type=int, default=500)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=2, help="graphs side by side; each takes about one core")
    parser.add_argument("--only", nargs="+", choices=sorted(KINDS), default=[], metavar="KIND")
    parser.add_argument("--setup", nargs="+", choices=sorted(SETUPS), default=[])
    parser.add_argument("--domain", type=int, default=20, help="first ROS domain; 20 for each job are used")
    parser.add_argument("--work", type=Path, default=Path("/tmp/tel_faults"), help="for runs and results")
    parser.add_argument(
        "--again",
        nargs="+",
        type=int,
        default=[],
        metavar="INDEX",
        help="inject these again; what was found before stays on the page",
    )
    parser.add_argument("--stored", action="store_true", help="inject nothing; tell what is stored")
    parser.add_argument(
        "--keep", action="store_true", help="keep the runs of faults without a violation, too"
    )
    parser.add_argument(
        "--page", type=Path, help="where to write the page; none if --only or --setup is given"
    )
    options = parser.parse_args()
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    faults = plan(options.faults, options.seed, options.only, options.setup)
    work = options.work / f"seed_{options.seed}"
    work.mkdir(parents=True, exist_ok=True)
    results = work / "results.jsonl"
    if options.again and results.exists():
        set_aside(results, options.again)
    rows = stored(results, faults)
    done = {row.fault.index for row in rows}
    started = time.monotonic()
    runs = work / f"runs_{time.strftime('%Y%m%d-%H%M%S')}"
    left = [fault for fault in faults if fault.index not in done and not options.stored]
    for row in campaign(left, options.jobs, options.domain, runs, options.keep, results):
        rows.append(row)
        print(line(row), flush=True)
    rows = stored(results, faults) + [row for row in rows if row.skipped]
    rows.sort(key=lambda row: row.fault.index)
    print(table(rows))
    print(f"{len(left)} faults in {(time.monotonic() - started) / 60.0:.1f} min; results: {results}")
    if options.page or not (options.only or options.setup):
        command = (
            f"benchmarks/faults.py --faults {options.faults} --seed {options.seed} --jobs {options.jobs}"
        )
        for option in ("only", "setup"):
            names = getattr(options, option)
            command += f" --{option} {' '.join(names)}" if names else ""
        write_page(rows, options.page or ROOT / "docs" / "faults.md", command, len(faults))
    sys.exit(1 if any(row.violations for row in rows) else 0)


if __name__ == "__main__":
    main()
